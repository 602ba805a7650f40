"""What is measured of a step: its time beside the yardstick's, its memory, its first call."""

from __future__ import annotations

import importlib.util
import math
import statistics
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from speed.step import LEARNING_RATE, Size, cpu_seconds, make_step

from mcpilco.data import Stopwatch

BURST = 3
"""timed steps in a row, before it is the other's turn"""
WARM_UP = 2
MEMORY_STEPS = 10


def ratio(size: Size, engine: str, yardstick: Path, repeats: int) -> dict[str, object]:
    """CPU seconds of a step, and of the yardstick's, in turns; medians and quartiles."""
    module = load(yardstick)
    gps, policy, _ = module.make(size.samples, bases=size.bases)
    optimiser = torch.optim.Adam(policy.parameters(), LEARNING_RATE)

    def theirs() -> None:
        module.policy_step(gps, policy, optimiser, size.particles, size.steps)

    plain, fast = in_turns([theirs, make_step(size, engine)], repeats)
    by_turn = [
        statistics.median(p) / statistics.median(f) for p, f in zip(plain, fast, strict=True)
    ]
    plain, fast = np.ravel(plain), np.ravel(fast)
    return {
        "yardstick_s": round(float(np.median(plain)), 5),
        "ours_s": round(float(np.median(fast)), 5),
        "ratio": round(float(np.median(plain) / np.median(fast)), 2),
        "yardstick_quartiles_s": quartiles(plain, 5),
        "ours_quartiles_s": quartiles(fast, 5),
        "ratio_quartiles": quartiles(by_turn, 2),
    }


def in_turns(steps: list[Callable[[], object]], repeats: int) -> list[list[list[float]]]:
    """CPU seconds of each, `BURST` in each of its turns."""
    for step in steps:
        for _ in range(WARM_UP):
            step()
    times: list[list[list[float]]] = [[] for _ in steps]
    for _ in range(repeats):
        for step, taken in zip(steps, times, strict=True):
            step()  # memory and caches are those of a search, not of the other's step
            taken.append([cpu_seconds(step) for _ in range(BURST)])
    return times


def quartiles(values: object, digits: int) -> list[float]:
    return [round(float(q), digits) for q in np.quantile(values, (0.25, 0.75))]


def load(path: Path) -> ModuleType:
    """The yardstick, as a module."""
    spec = importlib.util.spec_from_file_location("yardstick", path)
    if spec is None or spec.loader is None or not path.is_file():
        raise SystemExit(f"--yardstick must be a Python file, got {path}.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def memory(size: Size, engine: str) -> dict[str, object]:
    """Peak resident set after some steps, above the resident set before the first [MB].

    An earlier process must have compiled the step, or the compiler's memory counts too.
    """
    step = make_step(size, engine)
    before = _megabytes("VmRSS")
    for _ in range(MEMORY_STEPS):
        step()
    return {"before_MB": round(before), "step_MB": round(_megabytes("VmHWM") - before, 1)}


def _megabytes(field: str) -> float:
    """What Linux tells of this process; ru_maxrss would begin with its parent's."""
    status = Path("/proc/self/status")
    if not status.exists():
        raise SystemExit("The memory of a step is read from /proc/self/status, which Linux has.")
    lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    return int(lines[field].split()[0]) * 1024 / 1e6


def first_call(size: Size, engine: str) -> dict[str, object]:
    """Seconds of the first step of this process, imports and the model's making excluded."""
    step = make_step(size, engine)
    watch = Stopwatch()
    cost, _ = step()
    spent = watch.read()
    if not math.isfinite(cost):
        raise SystemExit(f"The cost of the first step is {cost}.")
    return {"wall_s": round(spent.wall_s, 3), "cpu_s": round(spent.cpu_s, 3)}
