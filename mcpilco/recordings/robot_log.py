"""Log files of a robot: the columns of a MuJoCo model's joints, and stretches without gaps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from jaxtyping import Float

from mcpilco.plant import chain_of, load_mjcf
from mcpilco.recordings.reader import read_recordings
from mcpilco.recordings.recording import Recording, bridged
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
