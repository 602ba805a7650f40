"""How much longer does a policy step take over plants than in one: a ratio in one process.

python runs/speed_spread.py

Particles, cost, backward and Adam in the physics of a cart-pole with dry friction and a late motor,
compiled; the particles draw from one plant, from the parameters that were learned, or from a spread
over these and the effects. Steps take turns, on one thread.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

sys.path.append(str(Path(__file__).parent))

from harness import use_one_thread
from speed.measures import in_turns
from speed.step import DROPOUT, LEARNING_RATE

import envs
from mcpilco.agent import Model
from mcpilco.config import CART_POLE, Config, ModelConfig, Phase, SearchConfig
from mcpilco.data import Transitions
from mcpilco.policies import SumOfGaussians
from mcpilco.search import Adam, PolicySearch, Problem, rollout_of
from mcpilco.task import TaskSpec

EFFECTS = (("coulomb_friction", "cart", {"f_c": 1.0}), ("actuator_delay", "actuator", {"d": 0.05}))
KEYS = "name", "target", "parameters"
PLANT = {
    "format": 1,
    "plant": CART_POLE,
    "parameters": {},
    "effects": [dict(zip(KEYS, effect, strict=True)) for effect in EFFECTS],
}
CASES: dict[str, dict[str, Any]] = {
    "one plant": {"uncertainty": 0.0},
    "parameters that were learned": {},
    "a spread over plants": {"spread": {"all": 0.1, "f_c": 0.3, "d": 0.2}},
}
SAMPLES, PARTICLES, STEPS, BASES, REPEATS = 60, 96, 30, 100, 15


def main() -> int:
    use_one_thread()
    task = envs.CartPoleSwingUpEnv().task
    times = in_turns([_step(task, how) for how in CASES.values()], REPEATS)
    ms = [1e3 * float(np.median(np.ravel(taken))) for taken in times]
    for name, took in zip(CASES, ms, strict=True):
        print(f"{name}: {took:.2f} ms, {took / ms[0]:.2f} times one plant")
    return 0


def _step(task: TaskSpec, how: dict[str, Any]) -> Callable[[], object]:
    """A step of the policy search in a model of random transitions."""
    model = Model(ModelConfig(kernel="rbf", mean="physics", plant=PLANT, memory=1, **how), task)
    rng, seen = np.random.default_rng(0), task.after_inputs(1)
    states = rng.normal(size=(SAMPLES, 5)) * [0.5, 1.0, 2.0, 4.0, 3.0]
    inputs = rng.uniform(-10, 10, (SAMPLES, 1))
    rows = Transitions(states, inputs, states + 0.1 * rng.normal(size=states.shape))
    model.gp._start_from(*model.rows(rows))
    generator, width = torch.Generator().manual_seed(0), model.augmentation
    policy = SumOfGaussians(width, [-10.0], [10.0], BASES)
    span = torch.full((len(width.plain),), 3.0, dtype=torch.float64)
    policy.randomise(span, torch.ones_like(span), 1.0, 5.0, generator)
    start, std = (torch.tensor(x, dtype=torch.float64) for x in (seen.start_mean, seen.start_std))
    dynamics = model.dynamics(rows)
    do = rollout_of(Config(), dynamics, policy)
    problem = Problem(dynamics, task.cost, start, std, STEPS, 1.0, do, judged=4)
    phases = (Phase(LEARNING_RATE, DROPOUT),)
    search = PolicySearch(SearchConfig(particles=PARTICLES, phases=phases), generator)
    adam = Adam(policy)
    return lambda: search.step(problem, policy, adam, LEARNING_RATE, DROPOUT)


if __name__ == "__main__":
    sys.exit(main())
