"""How many policy steps a second a batch of seeds takes on a device, against one core.

    python runs/speed_seed_batch.py --device cuda --seeds-per-batch 1 16 64 256

Each row is a batch of seeds that search together on the device; the first is one seed with the
default engine on one thread of the CPU. All are timed in turn in one process, and the medians of
the wall times compared. "Seeds an hour" counts the policy steps of the preset `default` with four
trials and one start in each, and nothing else: fits, episodes and further starts come on top.
"""

from __future__ import annotations

import functools
import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
import tyro
from speed.step import TASK, Size, make_problem

from mcpilco.agent import SearchRequest, search_together
from mcpilco.config import PRESETS, Config, SearchConfig
from mcpilco.policies import cart_pole_cost
from mcpilco.search import PolicySearch, rollout, rollout_of
from mcpilco.sweep.batch import device_name, usable_device
from mcpilco.sweep.job import one_thread

TRIALS = 4
SWING_UP = replace(TASK, dt=0.1, start_std=(0.1,) * 4, cost=cart_pole_cost())
"""of the preset `default`"""


@dataclass(frozen=True)
class Arguments:
    """What is timed."""

    device: str = "cpu"
    """where batches search, such as cuda"""
    seeds_per_batch: tuple[int, ...] = (1, 4, 16)
    samples: int = 75
    """N of each GP; the four trials of the preset have 30 to 120"""
    particles: int = Config().search.particles
    horizon: int = 30
    """T"""
    bases: int = Config().policy.bases
    single: bool = False
    """roll out in float32"""
    steps: int = 10
    """policy steps in each timing"""
    repeats: int = 5


def make_request(arguments: Arguments, seed: int) -> SearchRequest:
    """A search of some steps, in a model of random data."""
    generator = torch.Generator().manual_seed(seed)
    size = Size(arguments.particles, arguments.samples, arguments.horizon, arguments.bases)
    problem, policy = make_problem(size, SWING_UP, generator, rollout)
    problem = replace(problem, rollout=rollout_of(Config(), problem.dynamics, policy))
    config = SearchConfig(
        particles=arguments.particles,
        steps=(arguments.steps,),
        restarts=(0,),
        evaluation_particles=2,
    )
    return SearchRequest(PolicySearch(config, generator), problem, policy, lambda: policy, 1)


def seconds(work: Callable[[], object]) -> float:
    before = time.perf_counter()
    work()
    return time.perf_counter() - before


def main() -> None:
    arguments = tyro.cli(Arguments)
    device = usable_device(arguments.device)
    dtype = torch.float32 if arguments.single else torch.float64
    requests = [make_request(arguments, seed) for seed in range(max(arguments.seeds_per_batch))]
    works: dict[int, Callable[[], object]] = {0: requests[0].answer}
    for size in arguments.seeds_per_batch:
        works[size] = functools.partial(search_together, requests[:size], device, dtype)
    with one_thread():
        for work in works.values():
            work()
        rounds = [
            {size: seconds(work) for size, work in works.items()} for _ in range(arguments.repeats)
        ]
    search = PRESETS["default"].config.search
    needed = sum(search.steps_of(trial) for trial in range(1, TRIALS + 1))
    print(f"{device_name(device)}, {dtype}, {arguments}")
    print(f"{'':>20} {'ms a step':>10} {'steps a second':>15} {'seeds an hour':>14} {'ratio':>7}")
    alone = None
    for size in works:
        step = statistics.median(one[size] for one in rounds) / arguments.steps
        rate = max(size, 1) / step
        alone = rate if alone is None else alone
        name = "one core, fused" if size == 0 else f"batch of {size}"
        print(
            f"{name:>20} {1e3 * step:10.2f} {rate:15.1f} {3600 * rate / needed:14.0f} "
            f"{rate / alone:7.2f}"
        )


if __name__ == "__main__":
    main()
