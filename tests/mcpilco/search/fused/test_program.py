"""Every component of a model goes through the compiled loops as through plain torch."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers its plants
from envs.plants import cart_pole
from mcpilco.agent import Model
from mcpilco.config import Config, ModelConfig
from mcpilco.data import Transitions
from mcpilco.kernels import Kernel
from mcpilco.policies import Dropout
from mcpilco.search import fused
from mcpilco.search.engine import rollout_of
from mcpilco.search.particles import rollout
from tests.mcpilco.conftest import make_policy

pytestmark = pytest.mark.xdist_group("compiled")  # one process compiles what all of them need

STEPS, PARTICLES = 8, 19


def described(*effects):
    told = [{"name": n, "target": at, "parameters": dict(p)} for n, at, p in effects]
    parameters = {"cart_mass": 0.6, "pole_length": 0.45}
    name = "mcpilco/CartPoleSwingUp-v0"
    return {"format": 1, "plant": name, "parameters": parameters, "effects": told}


EVERY = described(
    ("coulomb_friction", "cart", {"f_c": 0.1, "v_r": 0.1}),
    ("stribeck_friction", "pole", {"f_c": 0.01, "f_d": 0.01, "v_s": 0.5, "v_r": 0.1}),
    ("quadratic_drag", "cart", {"c": 0.05}),
    ("position_ripple", "pole", {"s": 0.05, "c": 0.05, "n": 3.0}),
    ("actuator_dead_zone", "actuator", {"d": 0.5}),
    ("actuator_saturation", "actuator", {"u_m": 8.0}),
)
LATE = described(
    ("actuator_delay", "actuator", {"d": 0.13}), ("actuator_lag", "actuator", {"T": 0.02})
)
COMPONENTS = {
    "physics": ModelConfig(kernel="rbf", mean="physics", plant=described()),
    "physics with effects": ModelConfig(kernel="mpk", mean="physics", plant=EVERY),
    "missing forces": ModelConfig(kernel="gip+rbf", mean="physics", plant=EVERY),
    "physics, trusted": ModelConfig(kernel="rbf", mean="physics", uncertainty=0.0),
    "physics of a late actuator": ModelConfig(mean="physics", plant=LATE, memory=3),
    "plants": ModelConfig(
        kernel="rbf", mean="physics", plant=EVERY, spread={"all": 0.1, "f_c": 0.3}
    ),
    "late plants": ModelConfig(
        kernel="rbf", mean="physics", plant=LATE, memory=3, spread={"d": 0.2, "T": 0.3}
    ),
    "features": ModelConfig(kernel="features+rbf", plant=described()),
    "friction": ModelConfig(kernel="friction+rbf+mpk"),
    "all": ModelConfig(kernel="features+friction+rbf", mean="physics", plant=described()),
    "memory": ModelConfig(memory=2),
    "lags": ModelConfig(kernel="sed-mpk+rbf+mpk", memory=3),
    "filter": ModelConfig(kernel="sed-fir", memory=2),
    "filter, features": ModelConfig(kernel="friction+sed-fir", memory=1),
    "filter, physics": ModelConfig(kernel="sed-fir+rbf", mean="physics", memory=3, plant=LATE),
    "full": ModelConfig(kernel="rbf", mean="physics", integration="full", plant=described()),
}
RARE = {"features", "friction", "filter", "filter, features", "lags", "memory"} | {
    name for name, config in COMPONENTS.items() if config.mean == "physics"
}
"""what no other test needs is compiled for them in double precision"""


def episode(task) -> Transitions:
    """Twelve noisy steps of the cart-pole."""
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-10, 10, (12, 1))
    states = cart_pole().simulate(np.zeros((1, 4)), inputs[None], task.dt)[0]
    states = states + 0.01 * rng.normal(size=states.shape)
    return Transitions(states[:-1], inputs, states[1:])


def give_forces(model) -> None:
    """A fourth of all forces that may be missing, with weights of any size."""
    rng, arrays = np.random.default_rng(1), model.to_arrays()
    roots = np.where(rng.uniform(size=arrays["physics.roots"].shape) < 0.25, 0.02, 0.0)
    mean = np.concatenate([arrays["physics.mean"], rng.normal(size=(roots > 0).sum())])
    told = {"roots": roots, "mean": mean, "covariance": 0.01 * np.eye(len(mean))}
    told["fastest"] = np.full(2, 1e3)
    model.load_arrays(arrays | {f"physics.{name}": value for name, value in told.items()})


def drawn(task, config):
    """Dynamics, not fitted: only their arithmetic matters; and a policy that sees all."""
    model, rows = Model(config, task), episode(task).after_inputs(config.memory)
    if model.physics is not None:
        model.physics.identify(rows, 0.01)
        if model.physics.missing is not None:
            give_forces(model)
    model.gp._start_from(*model.rows(rows))
    dynamics = model.dynamics(rows)
    if hasattr(dynamics, "draw"):
        dynamics = dynamics.draw(PARTICLES, torch.Generator().manual_seed(2))
    return dynamics, make_policy(task.after_inputs(config.memory))


def outcome(function, dynamics, policy, width, **how):
    generator = torch.Generator().manual_seed(1)
    start = 0.3 * torch.randn(PARTICLES, width, generator=generator, dtype=torch.float64)
    shape = STEPS, PARTICLES, dynamics.noise_dim
    noise = torch.randn(*shape, generator=generator, dtype=torch.float64)
    particles = function(dynamics, policy, start, noise, Dropout(0.25, 3), **how)
    value = particles.states.tanh().sum() + (0.1 * particles.inputs).sin().sum()
    return particles, torch.autograd.grad(value, list(policy.parameters()))


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in RARE else n for n in COMPONENTS]
)
def test_values_and_gradients_are_those_of_the_plain_rollout(task, name):
    dynamics, policy = drawn(task, COMPONENTS[name])
    width = policy.augmentation.state_dim
    plain = outcome(rollout, dynamics, policy, width)
    fast = outcome(fused.rollout, dynamics, policy, width)
    torch.testing.assert_close(fast[0].states, plain[0].states, rtol=1e-7, atol=1e-7)
    torch.testing.assert_close(fast[0].inputs, plain[0].inputs, rtol=1e-7, atol=1e-7)
    for a, b in zip(fast[1], plain[1], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-7 * float(b.abs().max()))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["physics with effects", "all"])
def test_single_precision_errs_by_as_much_as_its_digits(task, name):
    dynamics, policy = drawn(task, COMPONENTS[name])
    width = policy.augmentation.state_dim
    exact = outcome(rollout, dynamics, policy, width)
    single = outcome(fused.rollout, dynamics, policy, width, single=True)
    first = 1e-4 * exact[0].states[:3].abs().max()
    assert 0 < (single[0].states[:3] - exact[0].states[:3]).abs().max() < first
    for a, b in zip(single[1], exact[1], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-2, atol=1e-2 * float(b.abs().max()))


@pytest.mark.slow
def test_a_remembered_input_is_the_one_given_before(task):
    dynamics, policy = drawn(task, COMPONENTS["memory"])
    particles, _ = outcome(fused.rollout, dynamics, policy, 6)
    moved = (particles.states[2:, :, :4] != particles.states[1:-1, :, :4]).any(-1)
    torch.testing.assert_close(particles.states[2:, :, 4][moved], particles.inputs[1:, :, 0][moved])
    assert moved.float().mean() > 0.5


@pytest.mark.parametrize("name", COMPONENTS)
def test_the_compiled_loops_take_every_component(task, name):
    dynamics, policy = drawn(task, COMPONENTS[name])
    assert fused.unknown(dynamics, policy) is None
    assert rollout_of(Config(engine="eager"), dynamics, policy) is rollout


class Opaque(Kernel):
    """A kernel without a canonical form."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__(kernel.width, kernel.batch)
        self.kernel = kernel

    def forward(self, X1, X2):
        return self.kernel(X1, X2)

    def diag(self, X):
        return self.kernel.diag(X)

    def start_from(self, X, Y):
        self.kernel.start_from(X, Y)


@pytest.mark.slow
def test_any_other_kernel_is_rolled_out_in_torch_with_the_same_values(task):
    dynamics, policy = drawn(task, COMPONENTS["physics"])
    posterior = dynamics.model.posterior
    other = dataclasses.replace(posterior, kernel=Opaque(posterior.kernel))
    model = dynamics.model
    model = type(model)(other, model.augmentation, model.increment, model.bounds.numpy())
    slow = dataclasses.replace(dynamics, model=model)
    chosen = rollout_of(Config(), slow, policy)
    assert chosen is rollout
    ours, theirs = outcome(chosen, slow, policy, 4), outcome(fused.rollout, dynamics, policy, 4)
    torch.testing.assert_close(ours[0].states, theirs[0].states, rtol=1e-7, atol=1e-7)
