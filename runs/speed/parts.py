"""Where the time of a step goes: its compiled parts, each in a loop of its own.

A loop runs over the blocks, time steps and outputs of a real step, on the arrays that one was
called with. Parts that work in place come after those that make their operands, whose time is
subtracted.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable
from typing import Any
from unittest import mock

import numpy as np
from numba import njit
from speed.step import Size, cpu_seconds, make_step

from mcpilco.search import (
    OUTERMOST,
    PLAIN,
    TALL,
    multiply,
    multiply_lower,
    multiply_upper,
    pack,
    set_exponentials,
    strip,
)
from mcpilco.search.fused import engine as engine_module
from mcpilco.search.fused import policy as of_policy
from mcpilco.search.fused import posterior as of_posterior

PEAK_INNER = (64, 128, 256)
"""inner sizes of the products that are tried for the peak"""
PEAK_TIMES = 2000

_augment, _drop, _act = of_policy.augment, of_policy._drop, of_policy.act
_activate = of_policy.activate
_kernel, _weigh, _prior = of_posterior._kernel, of_posterior._weigh, of_posterior._prior
_shift, _sample = of_posterior._shift, of_posterior._sample
_differentiate = of_posterior._differentiate
_loop = njit(**{**OUTERMOST, "cache": False})


def shares(size: Size, engine: str, repeats: int) -> dict[str, Any]:
    """Milliseconds of each part of a step, and the rates of the triangular products [GFLOP/s]."""
    step = make_step(size, engine)
    calls = timed_step(step)[1]
    outcome: dict[str, list[float]] = {}
    for _ in range(repeats + 1):
        step()
        for name, seconds in timed_step(step)[0].items():
            outcome.setdefault(name, []).append(seconds)
        for name, sweep in SWEEPS.items():
            for _ in range(2):  # the first fetches the arrays into the cache
                seconds = cpu_seconds(lambda: [sweep(*call) for call in calls])  # noqa: B023
            outcome.setdefault(name, []).append(seconds)
    ms = {name: 1e3 * statistics.median(taken[1:]) for name, taken in outcome.items()}
    _, _, noise, arrays, _ = calls[0]
    return {
        "parts_ms": {name: round(value, 3) for name, value in parts(ms).items()},
        **rates(ms, size, noise.shape[1], arrays[2].alpha.dtype),
    }


def timed_step(step: Callable[[], object]) -> tuple[dict[str, float], list[tuple[Any, ...]]]:
    """CPU seconds of both sweeps and of all else in a step; what `forward` was called with."""
    spent = {"forward": 0.0, "backward": 0.0}
    calls = []

    def timed(name: str) -> Callable[..., None]:
        sweep = getattr(engine_module, name)

        def run(*arguments: Any) -> None:
            spent[name] += cpu_seconds(lambda: sweep(*arguments))
            if name == "forward":
                calls.append(arguments)

        return run

    with mock.patch.multiple(engine_module, **{name: timed(name) for name in spent}):
        total = cpu_seconds(step)
    return {**spent, "outside": total - sum(spent.values())}, calls


def parts(ms: dict[str, float]) -> dict[str, float]:
    """Times of the parts [ms], from those of the loops; they add up to that of the step."""
    forward = {
        "products with L^-1 and L^-T": ms["lower"] + ms["upper"],
        "other matrix products": ms["expand"]
        + ms["collect"]
        + ms["centres"]
        + ms["pulling"]
        - ms["shift"],
        "kernel, elementwise": ms["weigh"] - ms["expand"],
        "policy: activations, squashing": ms["augment"]
        + ms["exponentials"]
        - ms["centres"]
        + ms["act"]
        - ms["pulling"],
        "dropout": ms["drop"] - ms["exponentials"],
        "sampling and its derivative": ms["shift"]
        + ms["prior"]
        + ms["sample"]
        - ms["upper"]
        + ms["differentiate"],
    }
    return {
        **forward,
        "rest of the forward sweep": ms["forward"] - sum(forward.values()),
        "backward: activations anew": ms["activate"],
        "backward: rest": ms["backward"] - ms["activate"],
        "torch: random numbers, cost, Adam": ms["outside"],
    }


def rates(ms: dict[str, float], size: Size, outputs: int, dtype: np.dtype) -> dict[str, float]:
    """Rates of the two triangular products together and of the best tile product [GFLOP/s].

    The zeros beside the triangle and behind the last particle, which tiles multiply as well, do not
    count: N (N + 1) operations for a product with one particle.
    """
    work = 2 * size.samples * (size.samples + 1) * size.particles * size.steps * outputs
    rate = 1e-6 * work / (ms["lower"] + ms["upper"])
    best = peak(dtype)
    return {"triangular_gflops": round(rate, 1), "peak_gflops": round(best, 1)}


def peak(dtype: np.dtype) -> float:
    """The rate of the fastest product of tiles whose operands stay in the fastest cache."""
    rows, width = 4 * TALL, strip(dtype)
    found = []
    for inner in PEAK_INNER:
        packed = pack(np.ones((rows, inner), dtype))
        arrays = packed, np.ones((inner, width), dtype), np.empty((rows, width), dtype)
        seconds = min(cpu_seconds(lambda: _products(PEAK_TIMES, *arrays)) for _ in range(5))  # noqa: B023
        found.append(1e-9 * 2 * PEAK_TIMES * rows * inner * width / seconds)
    return max(found)


@_loop
def _products(times, packed, right, out):
    for _ in range(times):
        multiply(packed, right, out)


# The loops ----------------------------------------------------------------------------------------


def _each_step(part):
    """A sweep of a part of the policy; its arguments are those of the forward sweep."""

    @_loop
    def sweep(start, stop, noise, arrays, memory):
        mask, policy, _, _, _, trace = arrays
        policy_memory = memory[0]
        width = policy_memory.slope.size
        for first in range(start, stop, width):
            for t in range(noise.shape[0]):
                part(first, t, mask, policy, trace, policy_memory)

    return sweep


def _each_output(part):
    """The same for a part of the posterior."""

    @_loop
    def sweep(start, stop, noise, arrays, memory):
        _, _, model, _, _, trace = arrays
        policy_memory, model_memory = memory[:2]
        width = policy_memory.slope.size
        for first in range(start, stop, width):
            last = first + width
            for t in range(noise.shape[0]):
                for e in range(noise.shape[1]):
                    jacobian = trace.delta_jacobians[t, e, :, first:last]
                    part(e, noise[t, e, first:last], model, model_memory, jacobian)

    return sweep


@njit(**PLAIN)
def _augment_part(first, t, mask, policy, trace, memory):
    _augment(trace.states[t, :, first : first + memory.slope.size], policy, memory.z)


@njit(**PLAIN)
def _centres_part(first, t, mask, policy, trace, memory):
    multiply(policy.centres, memory.scaled, memory.phi)


@njit(**PLAIN)
def _exponentials_part(first, t, mask, policy, trace, memory):
    multiply(policy.centres, memory.scaled, memory.phi)
    set_exponentials(memory.flat_phi, memory.phi.dtype.type(1.0))


@njit(**PLAIN)
def _drop_part(first, t, mask, policy, trace, memory):
    multiply(policy.centres, memory.scaled, memory.phi)
    _drop(mask.keys[t], first, mask, memory.words, memory.phi)


@njit(**PLAIN)
def _activate_part(first, t, mask, policy, trace, memory):
    state = trace.states[t, :, first : first + memory.slope.size]
    _activate(state, first, t, mask, policy, memory)


@njit(**PLAIN)
def _pulling_part(first, t, mask, policy, trace, memory):
    multiply(policy.pulling, memory.phi, memory.pulls)


@njit(**PLAIN)
def _act_part(first, t, mask, policy, trace, memory):
    last = first + memory.slope.size
    jacobian = trace.input_jacobians[t, :, :, first:last]
    _act(policy, memory, trace.inputs[t, :, first:last], jacobian)


@njit(**PLAIN)
def _shift_part(e, eps, model, memory, jacobian):
    _shift(e, model, memory)


@njit(**PLAIN)
def _expand_part(e, eps, model, memory, jacobian):
    _shift(e, model, memory)
    multiply(model.expand[e], memory.x, memory.groups)


@njit(**PLAIN)
def _weigh_part(e, eps, model, memory, jacobian):
    _expand_part(e, eps, model, memory, jacobian)
    _kernel(e, model, memory)
    _weigh(e, model, memory)


@njit(**PLAIN)
def _lower_part(e, eps, model, memory, jacobian):
    multiply_lower(model.whiten[e], memory.kernel, memory.white)


@njit(**PLAIN)
def _upper_part(e, eps, model, memory, jacobian):
    multiply_upper(model.unwhiten[e], memory.white, memory.solved)


@njit(**PLAIN)
def _sample_part(e, eps, model, memory, jacobian):
    multiply_upper(model.unwhiten[e], memory.white, memory.solved)
    _sample(e, eps, model, memory)


@njit(**PLAIN)
def _prior_part(e, eps, model, memory, jacobian):
    _prior(e, model, memory)


@njit(**PLAIN)
def _collect_part(e, eps, model, memory, jacobian):
    multiply(model.collect[e], memory.groups, memory.moments)


@njit(**PLAIN)
def _differentiate_part(e, eps, model, memory, jacobian):
    _differentiate(e, model, memory, jacobian)


SWEEPS = {
    "augment": _each_step(_augment_part),
    "centres": _each_step(_centres_part),
    "exponentials": _each_step(_exponentials_part),
    "drop": _each_step(_drop_part),
    "activate": _each_step(_activate_part),
    "pulling": _each_step(_pulling_part),
    "act": _each_step(_act_part),
    "shift": _each_output(_shift_part),
    "expand": _each_output(_expand_part),
    "lower": _each_output(_lower_part),
    "upper": _each_output(_upper_part),
    "prior": _each_output(_prior_part),
    "sample": _each_output(_sample_part),
    "weigh": _each_output(_weigh_part),
    "collect": _each_output(_collect_part),
    "differentiate": _each_output(_differentiate_part),
}
