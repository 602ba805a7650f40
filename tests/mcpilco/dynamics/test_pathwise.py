"""Laws of functions drawn from a posterior: right in law, the same when asked again, cheap."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from mcpilco.agent import MCPILCO
from mcpilco.config import ModelConfig
from mcpilco.dynamics.dynamics import GPDynamics
from mcpilco.dynamics.pathwise import Paths, PathSampler, PathwiseDynamics, PathwisePosterior
from mcpilco.gp import GP, Posterior
from mcpilco.kernels import MPK, RBF, ActiveDims, Kernel, Linear, NoCanonicalFormError
from mcpilco.search import Problem, fused, rollout
from mcpilco.task import TaskSpec
from mcpilco.typing import Dynamics, InputError, UncertainDynamics
from tests.mcpilco.conftest import make_dynamics, make_policy
from tests.mcpilco.kernels.test_kernels import shake
from tests.mcpilco.point import STEPS, TINY, PointEnv

D, OUTPUTS = 3, (2,)

KERNELS: dict[str, Callable[[], Kernel]] = {
    "RBF": lambda: RBF(D, OUTPUTS),
    "Linear": lambda: Linear(D, OUTPUTS),
    "MPK": lambda: MPK(D, 2, OUTPUTS),
    "RBF + MPK": lambda: RBF(D, OUTPUTS) + MPK(D, 2, OUTPUTS),
    "RBF * Linear": lambda: RBF(D, OUTPUTS) * Linear(D, OUTPUTS),
    "RBF + RBF * MPK": lambda: RBF(D, OUTPUTS) + RBF(D, OUTPUTS) * MPK(D, 2, OUTPUTS),
    "ActiveDims": lambda: ActiveDims(RBF(2, OUTPUTS), (2, 0), D) + Linear(D, OUTPUTS),
}


def normal(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def make_posterior(kernel: Kernel, samples: int = 12, noise_std: float = 0.3) -> Posterior:
    """Given random smooth data; the outputs' hyperparameters differ."""
    X = normal(samples, D)
    Y = torch.sin(X @ normal(D, 2, seed=1))
    kernel.start_from(X, Y)
    return GP(shake(kernel), noise_std=noise_std, noise_floor=0.0).condition(X, Y)


def at(paths: Paths, X: Tensor, particles: int) -> Tensor:
    """The values of all particles' functions at the same M points, (P, M, E)."""
    return paths(X[:, None].expand(-1, particles, -1)).transpose(0, 1)


def mean_and_covariance(posterior: Posterior, X: Tensor) -> tuple[Tensor, Tensor]:
    """Of the latent functions at several points, (E, M) and (E, M, M); R&W eqs. (2.23), (2.24)."""
    Kq, inverse = posterior.kernel(posterior.X, X), posterior.L_inv.mT @ posterior.L_inv
    mean = (Kq.mT @ posterior.alpha[..., None]).squeeze(-1)
    return mean, posterior.kernel(X, X) - Kq.mT @ inverse @ Kq


# --- the law of the draws -------------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_draws_have_the_mean_and_joint_covariance_of_the_posterior(name: str) -> None:
    """Draws are independent of one another; their particles share frequencies."""
    posterior, X, count, particles = make_posterior(KERNELS[name]()), 1.5 * normal(4, D), 50, 200
    sampler, random = PathSampler(posterior, features=32), generator()
    mean, covariance = mean_and_covariance(posterior, X)
    std = covariance.diagonal(dim1=-2, dim2=-1).sqrt()
    draws = [at(sampler.draw(particles, random), X, particles) for _ in range(count)]
    standardised = (torch.stack(draws).transpose(-1, -2) - mean) / std  # S P E M

    error = standardised.mean((0, 1)).abs().max()
    assert error < 5 / math.sqrt(count * particles)

    found = torch.einsum("spem,spen->semn", standardised, standardised) / particles
    expected = covariance / (std[..., :, None] * std[..., None, :])
    deviation = found.std(0) / math.sqrt(count)
    assert deviation.max() < 0.05  # else any covariance would do
    assert ((found.mean(0) - expected).abs() < 5 * deviation).all()


def test_draws_of_different_outputs_are_independent() -> None:
    posterior, count = make_posterior(KERNELS["RBF + MPK"]()), 4000
    values = at(PathSampler(posterior).draw(count, generator()), 3 * normal(1, D), count)[:, 0]
    correlation = torch.corrcoef(values.T)[0, 1]
    assert abs(correlation) < 5 / math.sqrt(count)


@pytest.mark.parametrize("name", KERNELS)
def test_draws_pass_through_data_without_noise(name: str) -> None:
    """Three samples, which even a linear function can pass through."""
    posterior = make_posterior(KERNELS[name](), samples=3, noise_std=1e-6)
    values = at(PathSampler(posterior).draw(20, generator()), posterior.X, 20)
    Y = torch.sin(posterior.X @ normal(D, 2, seed=1))
    assert (values - Y).abs().max() < 1e-4
    elsewhere = at(PathSampler(posterior).draw(20, generator()), normal(3, D, seed=5), 20)
    assert (elsewhere.std(0) > 1e-3).all()


FAR = torch.tensor([[100.0] * D, [101.0] + [100.0] * (D - 1)]).double()
"""so far from the samples that a draw is one from the prior"""


def prior_errors(features: int, particles: int, sets: int = 60) -> Tensor:
    """Of the covariance at two points a lengthscale apart, found from all particles of a draw."""
    posterior = GP(RBF(D, OUTPUTS, variance=2.0)).condition(normal(4, D), normal(4, 2, seed=1))
    sampler, random = PathSampler(posterior, features), generator()
    draws = [at(sampler.draw(particles, random), FAR, particles) for _ in range(sets)]
    values = torch.stack(draws)  # S P M E
    variance = values.square().mean(1)  # right with any number of features
    assert ((variance - 2.0).abs() < 5 * 2.0 * math.sqrt(2 / particles)).all()
    return (values[:, :, 0] * values[:, :, 1]).mean(1) - 2.0 * math.exp(-0.5)


@pytest.mark.slow
def test_prior_covariance_error_falls_as_one_over_the_root_of_the_features() -> None:
    """Of a prime number of particles: all share one set of frequencies."""
    few, many = 4, 64
    errors = [prior_errors(features, 4001).square().mean().sqrt() for features in (few, many)]
    slope = math.log(errors[1] / errors[0]) / math.log(many / few)
    assert slope == pytest.approx(-0.5, abs=0.1)


def test_an_average_over_particles_errs_less_for_they_share_several_sets_of_frequencies() -> None:
    one_set, eight_sets = (prior_errors(4, particles).std() for particles in (1601, 1600))
    assert eight_sets / one_set == pytest.approx(1 / math.sqrt(8), rel=0.3)


@pytest.mark.parametrize("particles", [1, 2, 7, 12, 13])
def test_any_number_of_particles_can_be_drawn(particles: int) -> None:
    paths = PathSampler(make_posterior(KERNELS["RBF * Linear"]())).draw(particles, generator())
    assert paths(normal(3, particles, D)).shape == (3, particles, 2)


@pytest.mark.parametrize("name", ["Linear", "MPK"])
def test_polynomial_kernels_need_no_random_features(name: str) -> None:
    posterior, X = make_posterior(KERNELS[name]()), 10 * normal(6, D)
    few, many = (PathSampler(posterior, features) for features in (2, 1000))
    first, second = (at(sampler.draw(5, generator()), X, 5) for sampler in (few, many))
    assert torch.equal(first, second)


def test_functions_of_a_quadratic_kernel_are_quadratic() -> None:
    """Their third differences vanish, far from the data too."""
    paths = PathSampler(make_posterior(MPK(D, 2, OUTPUTS))).draw(5, generator())
    line = torch.arange(4.0).double()[:, None] * normal(1, D) + 10 * normal(1, D, seed=1)
    values = at(paths, line, 5)
    assert values.diff(n=3, dim=1).abs().max() < 1e-9 * values.abs().max()
    assert values.diff(n=2, dim=1).abs().max() > 1e-3 * values.abs().max()


# --- a function is a function ---------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_a_function_answers_the_same_whenever_it_is_asked(name: str) -> None:
    paths = PathSampler(make_posterior(KERNELS[name]())).draw(6, generator())
    X = normal(5, 6, D)
    together = paths(X)
    assert together.shape == (5, 6, 2)
    again = torch.stack([paths(x) for x in X.flip(0)]).flip(0)
    torch.testing.assert_close(again, together, rtol=1e-12, atol=1e-12)


def test_each_particle_and_output_has_its_own_function() -> None:
    values = at(PathSampler(make_posterior(KERNELS["RBF"]())).draw(6, generator()), normal(1, D), 6)
    assert len(values.unique()) == 12


def test_equal_seeds_give_equal_draws_and_later_ones_differ() -> None:
    sampler, X, random = (
        PathSampler(make_posterior(KERNELS["RBF + MPK"]())),
        normal(4, D),
        generator(),
    )
    first, second = (sampler.draw(4, random)(X) for _ in range(2))
    assert torch.equal(sampler.draw(4, generator())(X), first)
    assert not torch.equal(first, second)


@pytest.mark.parametrize("name", KERNELS)
def test_gradients_equal_finite_differences(name: str) -> None:
    paths = PathSampler(make_posterior(KERNELS[name]()), features=8).draw(3, generator())
    assert torch.autograd.gradcheck(paths, (normal(2, 3, D).requires_grad_(),))


def test_draws_hold_no_graph() -> None:
    paths = PathSampler(make_posterior(KERNELS["RBF * Linear"]())).draw(3, generator())
    assert not paths(normal(3, D)).requires_grad


# --- cost -----------------------------------------------------------------------------------------


def operations(function: Callable[[Tensor], Tensor], particles: int) -> int:
    """Multiplications in the matrix products of a value and its gradient."""
    X = normal(particles, D).requires_grad_()
    with FlopCounterMode(display=False) as counter:
        function(X).sum().backward()
    return counter.get_total_flops()


def test_a_value_takes_work_linear_in_the_samples() -> None:
    """Second differences over 20, 40, 60 samples: none for paths, some for the variance."""
    paths, variances = [], []
    for samples in (20, 40, 60):
        posterior = make_posterior(KERNELS["RBF + MPK"](), samples)
        paths.append(operations(PathSampler(posterior, 16).draw(7, generator()), 7))
        variances.append(operations(lambda X, p=posterior: p.mean_and_variance(X)[1], 7))
    assert paths[0] < paths[1]
    assert paths[2] - paths[1] == paths[1] - paths[0]
    assert variances[2] - variances[1] > 1.2 * (variances[1] - variances[0])


def test_polynomial_functions_know_the_samples_by_their_weights() -> None:
    few, many = (
        operations(PathSampler(make_posterior(MPK(D, 2, OUTPUTS), n)).draw(7, generator()), 7)
        for n in (20, 200)
    )
    assert few == many


# --- dynamics -------------------------------------------------------------------------------------


def make_problem(task: TaskSpec, dynamics: Dynamics | UncertainDynamics) -> Problem:
    start = torch.zeros(4, dtype=torch.float64)
    return Problem(dynamics, task.cost, start, start + 0.1, 7, 1.0, rollout)


def nothing(particles: int) -> Tensor:
    return torch.zeros(particles, 0, dtype=torch.float64)


def test_a_model_is_drawn_once_for_each_rollout(task: TaskSpec) -> None:
    uncertain = PathwisePosterior(make_dynamics(task), features=16)
    assert isinstance(uncertain, UncertainDynamics)
    problem, policy, random = make_problem(task, uncertain), make_policy(task), generator()
    first, second = (problem.particles(policy, 5, random) for _ in range(2))
    again = problem.particles(policy, 5, generator())
    assert torch.equal(first.states, again.states)
    assert not torch.equal(first.states, second.states)

    random = generator()
    start = 0.1 * torch.randn(5, 4, generator=random, dtype=torch.float64)
    drawn = uncertain.draw(5, random)
    assert isinstance(drawn, Dynamics)
    torch.testing.assert_close(rollout(drawn, policy, start, normal(7, 5, 0)).states, first.states)


def test_steps_draw_the_numbers_that_they_always_drew(task: TaskSpec) -> None:
    dynamics, policy, random = make_dynamics(task), make_policy(task), generator()
    found = make_problem(task, dynamics).particles(policy, 5, random)
    by_hand = generator()
    start = 0.1 * torch.randn(5, 4, generator=by_hand, dtype=torch.float64)
    noise = torch.randn(7, 5, 2, generator=by_hand, dtype=torch.float64)
    assert torch.equal(found.states, rollout(dynamics, policy, start, noise).states)
    assert torch.equal(random.get_state(), by_hand.get_state())


def test_a_particle_that_returns_meets_what_it_met(task: TaskSpec) -> None:
    dynamics = PathwisePosterior(make_dynamics(task)).draw(9, generator())
    assert dynamics.noise_dim == 0
    states, inputs = normal(9, 4), normal(9, 1, seed=1)
    first = dynamics.step(states, inputs, nothing(9))
    dynamics.step(first, inputs, nothing(9))
    assert torch.equal(dynamics.step(states, inputs, nothing(9)), first)


def test_a_step_is_the_functions_through_the_law_of_the_model(task: TaskSpec) -> None:
    model = make_dynamics(task)
    dynamics = PathwisePosterior(model).draw(9, generator())
    states, inputs = normal(9, 4), normal(9, 1, seed=1)
    delta = dynamics.paths(model.augmentation.regressors(states, inputs))
    following = dynamics.step(states, inputs, nothing(9))
    torch.testing.assert_close(following[:, [1, 3]], states[:, [1, 3]] + delta)
    positions = states[:, [0, 2]] + task.dt * (states[:, [1, 3]] + following[:, [1, 3]]) / 2
    torch.testing.assert_close(following[:, [0, 2]], positions)


def test_one_step_has_the_law_of_a_step_of_the_model(task: TaskSpec) -> None:
    model, count = make_dynamics(task), 5000
    states, inputs = normal(1, 4).expand(count, 4), normal(1, 1, seed=1).expand(count, 1)
    with torch.no_grad():
        paths = PathwisePosterior(model, 1024).draw(count, generator())
        by_path = paths.step(states, inputs, nothing(count))
        by_step = model.step(states, inputs, normal(count, 2, seed=3))
    error = by_step.std(0) / math.sqrt(count / 2)
    assert ((by_path.mean(0) - by_step.mean(0)).abs() < 5 * error).all()
    torch.testing.assert_close(by_path.std(0), by_step.std(0), rtol=0.1, atol=0)


def test_a_particle_that_would_leave_the_plausible_range_stays(task: TaskSpec) -> None:
    free, held = (
        PathwisePosterior(make_dynamics(task, bounds=bounds)).draw(200, generator())
        for bounds in (1e9, 1.0)
    )
    states, inputs = normal(200, 4), normal(200, 1, seed=1)
    moved = free.step(states, inputs, nothing(200))
    leaves = (moved[:, [1, 3]].abs() > 1.0).any(-1)
    assert 0 < leaves.sum() < 200
    expected = torch.where(leaves[:, None], states, moved)
    assert torch.equal(held.step(states, inputs, nothing(200)), expected)


def test_gradients_of_a_rollout_equal_finite_differences(task: TaskSpec) -> None:
    dynamics = PathwisePosterior(make_dynamics(task), features=8).draw(2, generator())

    def final(start: Tensor) -> Tensor:
        return rollout(dynamics, make_policy(task, bases=4), start, normal(3, 2, 0)).states[-1]

    assert torch.autograd.gradcheck(final, ((0.1 * normal(2, 4)).requires_grad_(),))


def test_the_compiled_loops_leave_paths_to_plain_torch(task: TaskSpec) -> None:
    uncertain, policy = PathwisePosterior(make_dynamics(task)), make_policy(task)
    assert not isinstance(uncertain, Dynamics)
    assert "PathwiseDynamics" in fused.unknown(uncertain.draw(3, generator()), policy)


# --- the agent ------------------------------------------------------------------------------------

PATHS = dataclasses.replace(
    TINY, model=ModelConfig(kernel="rbf+mpk", sampling="path", path_features=16)
)


def make_agent(**changes) -> MCPILCO:
    config = dataclasses.replace(PATHS, **changes)
    return MCPILCO("SumOfGaussians", PointEnv(), config=config, seed=0)


@pytest.mark.parametrize("engine", ["eager", "fused"])
def test_an_agent_learns_with_paths(engine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    stepped: list[type] = []
    step = PathwiseDynamics.step

    def spy(self, *arguments):
        stepped.append(type(self))
        return step(self, *arguments)

    monkeypatch.setattr(PathwiseDynamics, "step", spy)
    agent = make_agent(engine=engine).learn(3 * STEPS)
    assert agent.trials == 2
    rollouts = 2 * (TINY.search.steps[0] + 2)  # the first and the last policy are judged
    assert len(stepped) == rollouts * STEPS
    assert all(np.isfinite(result.predicted_cost) for result in agent.results)


def test_an_agent_with_paths_goes_on_where_it_was_saved(tmp_path: Path) -> None:
    agent = make_agent().learn(2 * STEPS)
    loaded = MCPILCO.load(agent.save(tmp_path / "agent"), PointEnv())
    assert loaded.config == agent.config == PATHS
    observation = np.array([0.3, -0.2])
    np.testing.assert_array_equal(loaded.predict(observation)[0], agent.predict(observation)[0])
    again = MCPILCO.load(agent.save(tmp_path / "agent"), PointEnv())
    costs = [copy.learn(STEPS).results[-1].predicted_cost for copy in (loaded, again)]
    assert costs[0] == costs[1]


def test_the_default_samples_by_steps() -> None:
    assert ModelConfig().sampling == "step"
    agent = make_agent(model=dataclasses.replace(PATHS.model, sampling="step")).learn(2 * STEPS)
    assert type(agent.model.dynamics(agent.transitions)) is GPDynamics


# --- what does not fit ----------------------------------------------------------------------------


@pytest.mark.parametrize("features", [-2, 0, 1, 7])
def test_features_come_in_pairs(features: int) -> None:
    with pytest.raises(InputError, match=f"even number of at least 2.*got {features}"):
        PathSampler(make_posterior(RBF(D, OUTPUTS)), features)


def test_a_kernel_without_canonical_form_is_named() -> None:
    class Cosine(RBF):
        terms = Kernel.terms

    with pytest.raises(NoCanonicalFormError, match="Cosine has no canonical form"):
        PathSampler(make_posterior(Cosine(D, OUTPUTS)))
