"""Open-loop inputs that make a system show what it is made of.

No single kind of motion shows every effect. A recording is therefore a sequence of parts, in random
order, with pauses between them:

`multisine`  many frequencies at once, with random phases, up to a fifth of the sampling rate:
             inertia, delay and lag, which show at high frequencies, and a hardening spring, which
             shows at large ones of its amplitudes
`chirp`      one frequency at a time, rising: where in frequency a disagreement is
`slow`       small and slow triangles: the dead zone of an actuator, stick and slip, Coulomb
             friction against viscous friction, ripple over the position
`pulses`     steps to a few amplitude levels, up to the limits, held and reversed: saturation,
             actuator lag, drag at high speed, backlash at the reversals
`holds`      constant inputs, in both directions: gravity, springs, offsets, gain
`pause`      no input: the envelope of free decay separates viscous, Coulomb friction and drag

The parts sum to about zero, the pulses also in their double integral, so that a joint that nothing
holds, such as a cart, does not leave for good.

Reference: the shapes are standard in system identification (Ljung, System Identification, 1999,
section 13.3); the choice is by which effect each of them shows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from mcpilco.typing import InputError

PART_S = 2.0
"""length of a part [s], roughly"""
PAUSE_S = 0.5
"""length of the pauses between the parts [s], roughly"""
_SMALL = (0.02, 0.15)  # amplitudes of the slow part, of the half range
_LARGE = (0.3, 1.0)  # amplitudes of the other parts
_LEVELS = (0.25, 0.5, 1.0)  # of the pulses
_FASTEST = 0.2  # highest frequency, of the sampling rate
_LOWEST_HZ = 0.2

Part = Callable[[np.ndarray, np.random.Generator], np.ndarray]
"""from times [s] and random numbers to an input in [-1, 1]"""


def excitation(
    low: Float[np.ndarray, " U"],
    high: Float[np.ndarray, " U"],
    steps: int,
    dt: float,
    rng: np.random.Generator,
) -> Float[np.ndarray, "T U"]:
    """Inputs for T steps, each held for dt, within their bounds.

    Every input has its own sequence of parts, so that no two move together throughout.

    Raises:
        InputError: the bounds are not finite, or steps or dt not positive.
    """
    if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
        raise InputError(
            "An excitation needs finite bounds low < high for each input, "
            f"got low {low.tolist()}, high {high.tolist()}; bound the env's action space."
        )
    if steps < 1 or not dt > 0:
        raise InputError(f"An excitation needs steps >= 1 and dt > 0 s, got {steps} and {dt}.")
    shapes = np.column_stack([_sequence(steps, dt, rng) for _ in low])
    rest = np.clip(0.0, low, high)  # no input, where the bounds allow it
    return rest + np.where(shapes >= 0, shapes * (high - rest), shapes * (rest - low))


def _sequence(steps: int, dt: float, rng: np.random.Generator) -> Float[np.ndarray, " T"]:
    """Parts in random order, each kind once before any comes again, with pauses."""
    pieces: list[np.ndarray] = []
    parts = tuple(PARTS.values())
    while sum(map(len, pieces)) < steps:
        for k in rng.permutation(len(parts)):
            length = max(4, round(PART_S * rng.uniform(0.7, 1.3) / dt))
            pause = max(1, round(PAUSE_S * rng.uniform(0.2, 1.8) / dt))
            time = dt * np.arange(length)
            pieces += [parts[k](time, rng), np.zeros(pause)]
    return np.concatenate(pieces)[:steps]


def repeated_part(
    part: Part, largest: Float[np.ndarray, " U"], seconds: float, times: int, dt: float
) -> Float[np.ndarray, "T U"]:
    """Inputs of one kind, a part some times in a row, up to the largest value of each input.

    Args:
        part: the kind.
        largest: values of the inputs.
        seconds: length of all together [s].
        times: how many parts these are.
        dt: for which each input is held [s].
    """
    time, rng = dt * np.arange(round(seconds / times / dt)), np.random.default_rng(0)
    return np.stack(
        [limit * np.concatenate([part(time, rng) for _ in range(times)]) for limit in largest],
        axis=1,
    )


def multisine(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sum of the harmonics of the part's length with random phases."""
    duration, highest = _span(time)
    harmonics = np.arange(1, max(2, int(highest * duration) + 1))
    phases = rng.uniform(0, 2 * np.pi, len(harmonics))
    angles = 2 * np.pi * harmonics[:, None] * time / duration + phases[:, None]
    return rng.uniform(*_LARGE) * _normal(np.cos(angles).sum(0))


def chirp(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A sine whose frequency rises, or falls, by the same factor in equal times."""
    duration, highest = _span(time)
    lowest = min(_LOWEST_HZ, highest / 2)
    rate = np.log(highest / lowest) / duration
    wave = np.sin(2 * np.pi * lowest * np.expm1(rate * time) / rate)
    wave = _normal(wave - wave.mean())[:: rng.choice([-1, 1])]
    return rng.uniform(*_LARGE) * rng.choice([-1.0, 1.0]) * wave


def slow(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One period of a small triangle."""
    duration, _ = _span(time)
    triangle = 2 * np.abs(2 * ((time / duration + 0.25) % 1) - 1) - 1
    return rng.uniform(*_SMALL) * rng.choice([-1.0, 1.0]) * triangle


def pulses(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pulses + - - + of each level, whose integral and double integral are zero."""
    result = np.zeros(len(time))
    bounds = np.linspace(0, len(time), len(_LEVELS) + 1).astype(int)
    for level, first, end in zip(rng.permutation(_LEVELS), bounds, bounds[1:], strict=False):
        quarter = (end - first) // 4
        sign = rng.choice([-1.0, 1.0])
        result[first : first + 4 * quarter] = level * sign * np.repeat([1, -1, -1, 1], quarter)
    return result


def holds(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A constant input, and then its opposite."""
    half = len(time) // 2
    sign = np.repeat([1.0, -1.0, 0.0], [half, half, len(time) - 2 * half])
    return rng.uniform(0.1, 0.6) * rng.choice([-1.0, 1.0]) * sign


PARTS: Mapping[str, Part] = {
    "a multisine": multisine,
    "a chirp": chirp,
    "small, slow triangles": slow,
    "pulses up to the limits": pulses,
    "constant inputs in both directions": holds,
}
"""the kinds of parts, in words; pauses come between them"""


def _span(time: np.ndarray) -> tuple[float, float]:
    """Duration [s] and highest frequency [Hz] of a part."""
    dt = float(time[1] - time[0])
    return dt * len(time), _FASTEST / dt


def _normal(wave: np.ndarray) -> np.ndarray:
    """The wave, with its largest value at 1."""
    largest = np.abs(wave).max()
    return wave / largest if largest > 0 else wave
