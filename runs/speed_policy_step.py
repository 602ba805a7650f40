"""How long one policy step takes, against a plain implementation of the same work.

    python runs/speed_policy_step.py --particles 400 --samples 60 --steps 60 --yardstick PATH

PATH is a file with `make(samples, bases=)` and `policy_step(gps, policy, optimiser, particles,
steps)`, one optimisation step written plainly in eager torch. Both run on one thread of one
process, in turn; the medians of the CPU times are compared. `--json` prints one JSON object as
the last line.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
import tyro

from mcpilco import fused
from mcpilco.config import Phase, SearchConfig
from mcpilco.costs import cart_pole_cost
from mcpilco.dynamics import GPDynamics, speed_integration
from mcpilco.features import AngleAugmentation
from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF
from mcpilco.policies import SumOfGaussians
from mcpilco.rollout import Problem, rollout
from mcpilco.search import PolicySearch
from mcpilco.task import TaskSpec

ENGINES = {
    "fused": fused.rollout,
    "float32": functools.partial(fused.rollout, single=True),
    "eager": rollout,
}
BURST = 3
"""timed steps in a row, before it is the other's turn"""


@dataclass(frozen=True)
class Arguments:
    """What is timed."""

    yardstick: Path
    """file with the plain implementation"""
    particles: int = 400
    samples: int = 60
    """N, training samples of each GP"""
    steps: int = 60
    """T, horizon"""
    bases: int = 200
    repeats: int = 15
    engine: str = "fused"
    """fused, float32 or eager"""
    json: bool = False
    """print one JSON object as the last line"""


def make_step(arguments: Arguments) -> Callable[[], object]:
    """Our step: particles, cost, backward and Adam, of random data."""
    cost = cart_pole_cost(1.0, 3.0)
    names = ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
    pairs = ((0, 1), (2, 3))
    task = TaskSpec(
        names,
        ("m", "m/s", "rad", "rad/s"),
        ("force",),
        ("N",),
        0.05,
        (2,),
        pairs,
        (0.0,) * 4,
        (0.01,) * 4,
        cost,
    )
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(arguments.samples, 6, generator=generator, dtype=torch.float64)
    Y = 0.003 * torch.randn(arguments.samples, 2, generator=generator, dtype=torch.float64)
    kernel = RBF(6, (2,)) + MPK(6, 2, (2,))
    kernel.start_from(X, Y)
    augmentation = AngleAugmentation(4, task.angles)
    posterior = GP(kernel, noise_floor=0.001).condition(X, Y)
    dynamics = GPDynamics(posterior, augmentation, speed_integration(task), np.full(2, 1e3))
    policy = SumOfGaussians(augmentation, [-10.0], [10.0], arguments.bases)
    span = torch.full((3,), torch.pi, dtype=torch.float64)
    policy.randomise(span, torch.ones_like(span), 1.0, 5.0, generator)
    start = torch.zeros(4, dtype=torch.float64)
    problem = Problem(
        dynamics, cost, start, start + 0.01, arguments.steps, 1.0, ENGINES[arguments.engine]
    )
    config = SearchConfig(
        particles=arguments.particles, phases=(Phase(0.01, 0.25),), clip_norm=None
    )
    search = PolicySearch(config, generator)
    optimiser = torch.optim.Adam(policy.parameters(), 0.01)
    return lambda: search.step(problem, policy, optimiser, dropout=0.25)


def load(path: Path) -> ModuleType:
    """The yardstick, as a module."""
    spec = importlib.util.spec_from_file_location("yardstick", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise SystemExit(f"--yardstick must be a Python file, got {path}.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def cpu_seconds(step: Callable[[], object]) -> float:
    before = time.process_time()
    step()
    return time.process_time() - before


def main() -> None:
    arguments = tyro.cli(Arguments)
    torch.set_num_threads(1)
    yardstick = load(arguments.yardstick)
    gps, policy, _ = yardstick.make(arguments.samples, bases=arguments.bases)
    optimiser = torch.optim.Adam(policy.parameters(), 0.01)
    ours = make_step(arguments)

    def theirs() -> None:
        yardstick.policy_step(gps, policy, optimiser, arguments.particles, arguments.steps)

    for step in (ours, theirs):
        step()
        step()
    times: dict[Callable[[], object], list[float]] = {theirs: [], ours: []}
    for _ in range(arguments.repeats):
        for step, taken in times.items():
            step()  # memory and caches are those of a search, not of the other's step
            taken += [cpu_seconds(step) for _ in range(BURST)]
    plain, fast = (statistics.median(taken) for taken in times.values())
    sizes = {k: getattr(arguments, k) for k in ("particles", "samples", "steps", "bases", "engine")}
    result = {
        **sizes,
        "yardstick_s": round(plain, 5),
        "ours_s": round(fast, 5),
        "ratio": round(plain / fast, 2),
    }
    for name, seconds in (("yardstick", plain), (arguments.engine, fast)):
        print(f"{name:>10} {1e3 * seconds:9.2f} ms")
    print(f"{'ratio':>10} {plain / fast:9.2f}")
    if arguments.json:
        print(json.dumps(result))


if __name__ == "__main__":
    main()
