from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal

from baselines.pilco.rollout import predicted
from mcpilco import MCPILCO
from mcpilco.config import Config
from mcpilco.data import Rollout
from tests.baselines.pilco.models import narrow_start, random_dynamics, random_policy

NOISE = np.array([0.1, 0.2, 0.1, 0.2])


@pytest.fixture(scope="module")
def bench(run):
    bench = run.Bench("cartpole")
    yield bench
    bench.close()


def test_models_learn_from_the_rollout_that_an_agent_of_the_seed_begins_with(bench):
    config = Config(excitation="random")
    agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", config=config, seed=3)
    (record,) = agent._explore()
    np.testing.assert_array_equal(bench.rollout("random", 3, 0).observations, record.observations)
    assert not np.array_equal(bench.rollout("random", 3, 1).inputs, record.inputs)


def test_the_policy_swings_the_pole_up(bench):
    """In most rollouts, as the page says; of three at least two."""
    outcomes = [bench.rollout("swing-up", 0, k).outcome["is_success"] for k in (1, 2, 3)]
    assert sum(outcomes) >= 2


@pytest.mark.slow  # fits models of rollouts
@pytest.mark.parametrize("kind", ["random", "swing-up"])
def test_a_forecast_starts_at_the_measurement_and_sees_nothing_of_what_came_after(bench, kind):
    models = bench._models(0)
    truth = bench.rollout(kind, 0, 1)
    other = Rollout(
        truth.dt,
        np.concatenate([truth.observations[:1], truth.observations[1:] + 9.0]),
        truth.inputs if kind == "random" else truth.inputs + 9.0,
        truth.rewards,
    )
    for model in models.values():
        found, again = (bench._forecast(model, kind, seen, (0, 0)) for seen in (truth, other))
        np.testing.assert_array_equal(found.mean, again.mean)
        off = np.abs(found.mean[0] - truth.observations[0]) / bench.noise_std
        assert off.max() < 5 / np.sqrt(400)
        np.testing.assert_allclose(np.sqrt(np.diag(found.cov[0])), bench.noise_std, rtol=0.2)


def test_near_the_start_of_random_rollouts_all_models_are_right(bench):
    """Their data are of such rollouts: else something is wrong with the bench."""
    models, truths = bench._models(1), [bench.rollout("random", 1, k) for k in (1, 2, 3)]
    for model in models.values():
        found = [bench._forecast(model, "random", truth, (1, 0)) for truth in truths]
        off = [
            f.mean[3, bench.angle] - t.states[3, bench.angle]
            for f, t in zip(found, truths, strict=True)
        ]
        motion = np.median([np.ptp(truth.states[:, bench.angle]) for truth in truths])
        assert np.median(np.abs(off)) < 0.1 * motion


# The measures -------------------------------------------------------------------------------------


@pytest.fixture
def drawn(run):
    """A Gaussian forecast, the same in particles, and a truth that is drawn from it."""
    from model_learning.forecasts import Forecast

    rng, steps = np.random.default_rng(0), 400
    root = rng.standard_normal((steps, 4, 4))
    mean, cov = rng.standard_normal((steps, 4)), root @ root.swapaxes(1, 2)
    normal = rng.standard_normal((steps, 1501, 4))
    points = mean[:, None] + np.einsum("tij,tpj->tpi", root, normal)
    states, particles = points[:, 0], points[:, 1:]
    seen = states + NOISE * rng.standard_normal(states.shape)
    truth = Rollout(0.1, seen, np.zeros((steps - 1, 1)), np.zeros(steps - 1), states)
    return Forecast(mean, cov), Forecast(mean, cov, particles), truth


def told(forecast, truth):
    from model_learning.measures import measure

    return measure(forecast, truth, NOISE, cart=0, angle=2)


def test_a_true_forecast_covers_the_truth_at_its_level(drawn):
    gaussian, particles, truth = drawn
    for forecast in (gaussian, particles):
        found = told(forecast, truth)
        for name in ("covered_angle", "covered_cart"):
            assert found[name].mean() == pytest.approx(0.95, abs=4 * np.sqrt(0.95 * 0.05 / 400))


def test_gaussian_and_particles_of_it_have_equal_errors(drawn):
    gaussian, particles, truth = drawn
    here, there = told(gaussian, truth), told(particles, truth)
    for name, index in (("rmse_angle", 2), ("rmse_cart", 0)):
        np.testing.assert_array_equal(here[name], there[name])
        square = np.square(particles.particles[..., index] - truth.states[:, None, index])
        np.testing.assert_allclose(here[name], np.sqrt(square.mean(1)), rtol=0.15)


def test_likelihood_is_that_of_the_measurement(drawn):
    gaussian, _, truth = drawn
    found, noise = told(gaussian, truth)["nll"], np.diag(NOISE**2)
    expected = [
        -multivariate_normal(m, S + noise).logpdf(y)
        for m, S, y in zip(gaussian.mean, gaussian.cov, truth.observations, strict=True)
    ]
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_a_particle_follows_until_it_is_once_too_far_or_stands_still(run):
    from model_learning.forecasts import Forecast

    path = np.zeros((5, 4))
    path[:, 2] = 0.01 * np.arange(5)
    particles = np.stack([path, path, path], axis=1)
    particles[2, 0, 2] += 1.0  # comes back
    particles[3:, 1] = particles[2, 1]  # stands still
    particles[:, 2, 2] += 0.4  # never near
    truth = Rollout(0.1, path, np.zeros((4, 1)), np.zeros(4), path)
    cov = np.broadcast_to(np.eye(4), (5, 4, 4))
    found = told(Forecast(path, cov, particles), truth)
    np.testing.assert_array_equal(found["follow"], [1, 1, 1, 0, 0])
    np.testing.assert_allclose(found["stopped"], [0, 0, 0, 1 / 3, 1 / 3])
    assert np.isnan(told(Forecast(path, cov), truth)["follow"]).all()


# The command --------------------------------------------------------------------------------------


@pytest.mark.slow  # trains, if quickly
def test_quick_writes_tables_and_pictures_and_goes_on(page_of_two, tmp_path, capsys):
    page = page_of_two("--systems", "cartpole")
    assert capsys.readouterr().out.count("cartpole, seed 0") == 1
    assert "### `mcpilco/CartPoleSwingUp-v0`, 1 seed\n" in page
    assert page.count("| RBF + MPK |") == 2 * 4
    for name in ("example", "errors"):
        assert (tmp_path / f"cartpole-{name}.png").read_bytes()[:4] == b"\x89PNG"


def test_a_file_of_a_seed_reads_back_what_was_measured(run, tmp_path):
    from model_learning.measures import COLUMNS, read_measured, write_measured

    rng = np.random.default_rng(0)
    measured = {name: np.round(rng.random(4), 3) for name in COLUMNS}
    measured["follow"] = np.full(4, np.nan)
    write_measured(tmp_path / "0000.csv", {("random", "pilco"): measured}, dt=0.1)
    found = read_measured(tmp_path / "0000.csv")["random", "pilco"]
    np.testing.assert_array_equal(found["time_s"], [0.0, 0.1, 0.2, 0.3])
    for name, values in measured.items():
        np.testing.assert_array_equal(found[name], values)


def test_known_inputs_push_as_a_policy_does_that_always_answers_them():
    from model_learning.forecasts import pushed

    dynamics = random_dynamics()
    policy = random_policy(dynamics)
    with torch.no_grad():
        policy.targets.zero_()
        states, inputs = predicted(dynamics, policy, narrow_start(), 2)
        state = narrow_start()
        for u in inputs.mean:
            state = pushed(dynamics, state, u)
    assert float(inputs.cov.abs().max()) == 0.0
    assert torch.allclose(state.mean, states.mean[2], atol=1e-14)
    assert torch.allclose(state.cov, states.cov[2], atol=1e-14)
