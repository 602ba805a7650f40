"""Recordings of an arm: their columns, and the samples that they hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.identification.collision.samples import WINDOW, ArmSamples, slopes
from mcpilco.recordings import Recording, read_recording
from mcpilco.typing import InputError

MOTION = ("position", "velocity")
"""states of a joint"""
DRIVEN = ("current", "target_position", "target_velocity", "target_current")
"""inputs of a joint: a recording's reader masks no spikes of these, and a push may begin as one"""


class ArmLog(Protocol):
    """What a simulated arm, or a driver, hands over: T samples of J joints."""

    @property
    def joints(self) -> tuple[str, ...]: ...
    @property
    def time(self) -> Float[np.ndarray, " T"]: ...
    @property
    def position(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def velocity(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def current(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def target_position(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def target_velocity(self) -> Float[np.ndarray, "T J"]: ...
    @property
    def target_current(self) -> Float[np.ndarray, "T J"]: ...


def columns_of(joints: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the states and inputs of an arm's recording."""
    return (
        tuple(f"{joint}_{what}" for joint in joints for what in MOTION),
        tuple(f"{joint}_{what}" for joint in joints for what in DRIVEN),
    )


def read_arm(
    path: str | Path,
    joints: Sequence[str],
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> Recording:
    """The recording of an arm; columns of velocities may be absent.

    Args:
        path: of the file.
        joints: names, in the robot's order.
        columns: the file's names, where they differ from `columns_of`.
        dt: sampling time to bring it to [s]; its own by default.

    Raises:
        RecordingError: the file cannot be read; the sentence says why.
    """
    states, inputs = columns_of(joints)
    pairs = [(k, k + 1) for k in range(0, len(states), len(MOTION))]
    return read_recording(path, states, inputs, velocities=pairs, columns=columns, dt=dt)


def samples_of(recording: Recording, window: int = WINDOW) -> ArmSamples:
    """The samples of a recording at which all is known.

    Derivatives see the past only, as a detector does; the first samples after a gap have none and
    are left out.

    Args:
        recording: with the columns of `columns_of`.
        window: samples over which a derivative is taken.

    Raises:
        InputError: at no sample all is known.
    """
    motion = recording.states.reshape(len(recording), -1, len(MOTION)).transpose(2, 0, 1)
    driven = recording.inputs.reshape(len(recording), -1, len(DRIVEN)).transpose(2, 0, 1)
    parts = []
    for part in recording.segments():
        (q, dq), (i, qt, dqt, ic) = motion[:, part], driven[:, part]
        absent = ~np.isfinite(dq).any(axis=0)
        dq = np.where(absent, slopes(q, recording.dt, window), dq)
        ddq = slopes(dq, recording.dt, window)
        parts.append(ArmSamples(recording.time[part], q, dq, ddq, qt - q, dqt - dq, ic, i))
    whole = ArmSamples.joined(parts)
    known = _known(whole)
    if not known.any():
        raise InputError(
            f"{recording.name}: expected samples at which positions, currents and targets of all "
            "joints are known, got none; log all joints at the same instants."
        )
    return whole[known]


def _known(samples: ArmSamples) -> Bool[np.ndarray, " N"]:
    return np.isfinite(np.hstack([samples.augmented, samples.i])).all(axis=1)


def arm_recording(name: str, log: ArmLog) -> Recording:
    """The recording of a log, as `read_arm` would read it.

    Args:
        name: of the recording.
        log: whose samples are evenly spaced.
    """
    states, inputs = columns_of(log.joints)

    def beside(what: Sequence[str]) -> Float[np.ndarray, "T D"]:
        """A joint's columns beside one another, and then those of the next."""
        return np.stack([getattr(log, entry) for entry in what], axis=2).reshape(len(log.time), -1)

    return Recording(name, log.time, beside(MOTION), beside(DRIVEN), states, inputs)
