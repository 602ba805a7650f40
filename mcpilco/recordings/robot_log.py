"""Log files of a robot: the columns of a MuJoCo model's joints, stretches without gaps, motions.

A `Segment` is a stretch; a `JointMotion` has filtered positions, velocities, accelerations and
forces of all joints. Encoders are noisy, and derivatives magnify their noise with the frequency.
Two filters:

- `zero_phase`: a Butterworth filter run forward and backward over positions and forces alike, so
  that nothing is delayed; then central differences, and fewer rows. `motion_cutoff` finds a cutoff
  for it.
- `local_cubics`: derivatives of a cubic fitted around each sample, forces as they were measured.

Reference: Janot, Vandanjon, Gautier, A generic instrumental variable approach for industrial robot
    identification, IEEE Transactions on Control Systems Technology 22 (1), 2014, section II;
    Savitzky, Golay, Smoothing and differentiation of data by simplified least squares procedures,
    Analytical Chemistry 36 (8), 1964.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.signal import butter, savgol_filter, sosfiltfilt, welch

from mcpilco.config import TURN_OVER
from mcpilco.mjcf import chain_of, load_mjcf
from mcpilco.plant import CoulombFriction
from mcpilco.recordings.reader import read_recordings
from mcpilco.recordings.recording import Recording, Samples, bridged
from mcpilco.recordings.table import read_table
from mcpilco.typing import InputError, RecordingError


@dataclass(frozen=True)
class Segment:
    """A stretch of a recording without a gap: T samples of J joints."""

    name: str
    """of the recording"""
    dt: float
    """sampling time [s]"""
    q: Float[np.ndarray, "T J"]
    """measured positions [rad or m]"""
    dq: Float[np.ndarray, "T J"]
    """measured velocities [rad/s or m/s]; columns of NaN where there were none"""
    tau: Float[np.ndarray, "T J"]
    """forces [N m or N]; 0 in joints without a motor"""
    reference: Float[np.ndarray, "T J"] | None = None
    """commanded positions, where they were logged [rad or m]"""


class Source(NamedTuple):
    """A column from which a joint's force, or a part of it, follows."""

    column: str
    joint: int
    factor: float = 1.0
    """force a unit of the column"""
    held: bool = False
    """whether it is a command, which holds from its row to the next"""
    low: float = -np.inf
    """least command that is obeyed"""
    high: float = np.inf


@dataclass(frozen=True)
class Columns:
    """The columns of a robot's log: joints, forces, references."""

    joints: tuple[str, ...]
    sources: tuple[Source, ...]
    slides: tuple[bool, ...]
    references: bool
    """whether commanded positions are there"""

    @property
    def states(self) -> tuple[str, ...]:
        """Positions, velocities, and commanded positions."""
        kinds = ("position", "velocity", *(("reference",) if self.references else ()))
        return tuple(f"{joint}_{kind}" for kind in kinds for joint in self.joints)


def load_robot(path: str | Path) -> mujoco.MjModel:
    """The model in an MJCF file: an open chain or tree, each body on at most one hinge or slide.

    Raises:
        InputError: there is no such file, it is no MJCF, or not such a robot.
    """
    model = load_mjcf(path)
    chain_of(model)
    for b in range(model.nbody):
        if model.body_jntnum[b] > 1:
            raise InputError(
                f"{path}: each body must have one joint, got {model.body_jntnum[b]} in "
                f"{model.body(b).name or f'body {b}'!r}; put each joint in a body of its own."
            )
    unnamed = [j for j in range(model.njnt) if not model.joint(j).name]
    if unnamed:
        raise InputError(
            f"{path}: each joint must have a name, got none for joint {unnamed[0]}; its columns "
            "are called by it."
        )
    return model


def read_robot(
    paths: Iterable[str | Path],
    model: mujoco.MjModel,
    columns: Mapping[str, str] | None = None,
    dt: float | None = None,
) -> tuple[list[Segment], list[RecordingError], list[str]]:
    """The stretches of all recordings that can be read, and what is wrong with others.

    All files have the columns of the first that can be read; `columns` are their names for `time`,
    `<joint>_position` and so on, where they differ. The step of the grid dt [s] is each log's own
    by default.

    Returns:
        Stretches, errors, and remarks on what was mended.

    Raises:
        InputError: the force of a motor of the model does not follow from its command.
        RecordingError: no file can be read.
    """
    paths, names = list(paths), dict(columns or {})
    found = _columns_of(paths, model, names)
    J = len(found.joints)
    hinges = [j for j, slides in enumerate(found.slides) if not slides]
    recordings, errors = read_recordings(
        paths,
        found.states,
        tuple(source.column for source in found.sources),
        angles=[*hinges, *([2 * J + j for j in hinges] if found.references else [])],
        velocities=[(j, J + j) for j in range(J)],
        columns=names,
        dt=dt,
    )
    segments = [part for recording in recordings for part in _segments(recording, found)]
    remarks = [f"{r.name}: {remark}" for r in recordings for remark in r.remarks]
    return segments, errors, remarks


def _columns_of(
    paths: Sequence[str | Path], model: mujoco.MjModel, names: Mapping[str, str]
) -> Columns:
    """The columns of the model's joints in the first file that can be read."""
    header: set[str] = set()
    error: RecordingError | None = None
    for path in paths:
        try:
            header = set(read_table(path).columns)
            break
        except RecordingError as fault:
            error = error or fault
    if not header:
        raise error or InputError("at least one recording was expected, got none; name its file.")

    def has(name: str) -> bool:
        return names.get(name, name) in header

    joints = tuple(model.joint(j).name for j in range(model.njnt))
    slides = tuple(bool(kind == int(mujoco.mjtJoint.mjJNT_SLIDE)) for kind in model.jnt_type)
    sources: list[Source] = []
    for j, joint in enumerate(joints):
        measured = f"{joint}_{'force' if slides[j] else 'torque'}"
        motors = [u for u in range(model.nu) if _drives(model, u, j)]
        if has(measured) or (motors and not any(has(model.actuator(u).name) for u in motors)):
            sources.append(Source(measured, j))
        else:
            sources += [_motor(model, u, j) for u in motors]
    if not sources:
        raise InputError(
            f"a column with a force was expected, {joints[0]}_torque for example, got "
            f"{', '.join(sorted(header))}; without forces there is nothing to identify."
        )
    return Columns(
        joints, tuple(sources), slides, all(has(f"{joint}_reference") for joint in joints)
    )


def _drives(model: mujoco.MjModel, u: int, j: int) -> bool:
    kind = model.actuator_trntype[u]
    joint = kind in (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
    return bool(joint and model.actuator_trnid[u, 0] == j)


def _motor(model: mujoco.MjModel, u: int, j: int) -> Source:
    """The column of a motor's command, as a force of its joint."""
    name = model.actuator(u).name
    plain = (
        model.actuator_biastype[u] == int(mujoco.mjtBias.mjBIAS_NONE)
        and model.actuator_dyntype[u] == int(mujoco.mjtDyn.mjDYN_NONE)
        and model.actuator_gaintype[u] == int(mujoco.mjtGain.mjGAIN_FIXED)
    )
    if not plain:
        raise InputError(
            f"actuator {name!r} must be a motor, whose command is a force; log the joint's force "
            f"as {model.joint(j).name}_torque."
        )
    limited = model.actuator_ctrllimited[u]
    low, high = model.actuator_ctrlrange[u] if limited else (-np.inf, np.inf)
    factor = float(model.actuator_gear[u, 0] * model.actuator_gainprm[u, 0])
    return Source(name, j, factor, True, float(low), float(high))


def _segments(recording: Recording, columns: Columns) -> Iterable[Segment]:
    J = len(columns.joints)
    forces = np.zeros((len(recording), J))
    for value, source in zip(recording.inputs.T, columns.sources, strict=True):
        command = np.clip(value, source.low, source.high)
        if source.held:  # what acts at a sample is the mean of what held before and after it
            command = 0.5 * (command + np.concatenate([command[:1], command[:-1]]))
        forces[:, source.joint] += source.factor * command
    for part in recording.segments():
        states = bridged(recording.states[part])
        if len(states) > 1 and np.isfinite(states[:, :J]).all():
            reference = states[:, 2 * J :] if columns.references else None
            dq = states[:, J : 2 * J]
            yield Segment(recording.name, recording.dt, states[:, :J], dq, forces[part], reference)


ByJoint = Float[np.ndarray, "T J"]
"""on a uniform grid of step dt [s]: positions q [rad or m], velocities dq [rad/s or m/s], of which
columns of NaN are derived from the positions, or forces tau [N m or N]"""

ORDER = 4
"""of the Butterworth filter, each way"""
ROWS_A_PERIOD = 8.0
"""rows that are kept in a period of the cutoff"""
LEFT_OUT = 3.0
"""periods of the cutoff at both ends, where a filter has nothing to go by"""
WINDOW = 15
"""samples of a local cubic"""
ABOVE_NOISE = 5.0
"""spectrum, relative to that of the noise, from which on there is motion [-]"""
MOVED = 0.99
"""share of the positions' variance that is within the motion's bandwidth [-]"""
MARGIN = 4.0
"""the cutoff, relative to that bandwidth [-]"""
_SECONDS = 4.0  # of the windows of a spectrum


@dataclass(frozen=True)
class JointMotion(Samples):
    """N rows of J joints; nothing is masked."""

    q: Float[np.ndarray, "N J"]
    """positions [rad or m]"""
    dq: Float[np.ndarray, "N J"]
    """velocities [rad/s or m/s]"""
    ddq: Float[np.ndarray, "N J"]
    """accelerations [rad/s^2 or m/s^2]"""
    tau: Float[np.ndarray, "N J"]
    """forces [N m or N]"""
    dry: Float[np.ndarray, "N J"]
    """what dry friction of 1 N m or 1 N would be, by the filter of the forces: it jumps, and a
    filtered jump is no jump of filtered velocities"""


def zero_phase(q: ByJoint, dq: ByJoint, tau: ByJoint, dt: float, cutoff: float) -> JointMotion:
    """A motion without what is faster than the cutoff [Hz].

    Raises:
        InputError: the cutoff is beyond half of the sampling rate, or there is too little.
    """
    if not 0.0 < cutoff < 0.5 / dt:
        raise InputError(
            f"cutoff must be between 0 and {0.5 / dt:g} Hz, half of the sampling rate, got "
            f"{cutoff:g}."
        )
    ends = round(LEFT_OUT / (cutoff * dt))
    _require_rows(q, 3 * ends, dt)
    smooth = butter(ORDER, cutoff, fs=1.0 / dt, output="sos")
    q, dq, tau = (sosfiltfilt(smooth, part, axis=0) for part in (q, dq, tau))
    dq = np.where(np.isfinite(dq), dq, np.gradient(q, dt, axis=0))
    ddq = np.gradient(dq, dt, axis=0)
    dry = sosfiltfilt(smooth, _dry(q, dq), axis=0)
    step = max(1, int(1.0 / (ROWS_A_PERIOD * cutoff * dt)))
    return JointMotion(q, dq, ddq, tau, dry)[ends:-ends:step]


def local_cubics(
    q: ByJoint, dq: ByJoint, tau: ByJoint, dt: float, window: int = WINDOW, step: int = 1
) -> JointMotion:
    """A motion by the cubic about each sample.

    Forces are not filtered; there is a row each `step` samples.

    Raises:
        InputError: there is too little.
    """
    _require_rows(q, 2 * window, dt)

    def cubics(values: np.ndarray, derivative: int) -> np.ndarray:
        return savgol_filter(values, window, 3, deriv=derivative, delta=dt, axis=0)

    measured = np.isfinite(dq).all(axis=0)
    known = np.where(measured, dq, 0.0)
    positions = cubics(q, 0)
    speeds = np.where(measured, cubics(known, 0), cubics(q, 1))
    accelerations = np.where(measured, cubics(known, 1), cubics(q, 2))
    dry = _dry(positions, speeds)
    motion = JointMotion(positions, speeds, accelerations, tau, dry)
    return motion[window:-window:step]


def motion_cutoff(q: ByJoint, dt: float) -> float:
    """Four times the bandwidth of the fastest joint's motion [Hz]; a fifth of the rate at most."""
    frequency, power, noise = _spectrum(q, dt)
    motion = np.where(power > ABOVE_NOISE * noise, power - noise, 0.0)
    share = np.cumsum(motion, axis=0)
    within = (share >= MOVED * share[-1]).argmax(axis=0)  # 0 where nothing moves
    return float(np.clip(MARGIN * frequency[within].max(), 2.0 * frequency[1], 0.2 / dt))


def encoder_noise(q: ByJoint, dt: float) -> Float[np.ndarray, " J"]:
    """Standard deviation of each position's noise [rad or m].

    White noise is as strong at all frequencies, and nothing moves at those above a quarter of the
    sampling rate.
    """
    return np.sqrt(_spectrum(q, dt)[2] * 0.5 / dt)


def _dry(q: ByJoint, dq: ByJoint) -> ByJoint:
    """Dry friction of 1 N m or 1 N, as a force that the motor supplies."""
    return CoulombFriction.force(q, dq, -1.0, TURN_OVER)


def _spectrum(
    q: ByJoint, dt: float
) -> tuple[Float[np.ndarray, " F"], Float[np.ndarray, "F J"], Float[np.ndarray, " J"]]:
    """Frequencies [Hz], power a Hz, and its mean in the upper half of them."""
    length = min(len(q), round(_SECONDS / dt))
    frequency, power = welch(q, 1.0 / dt, nperseg=length, detrend="linear", axis=0)
    return frequency, power, power[len(power) // 2 :].mean(axis=0)


def _require_rows(q: ByJoint, least: int, dt: float) -> None:
    if len(q) <= least:
        raise InputError(
            f"more than {least * dt:.3g} s without a gap were expected, got {len(q) * dt:.3g} s; "
            "record for longer."
        )
