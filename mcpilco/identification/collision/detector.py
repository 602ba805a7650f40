"""From residuals of the currents to alarms: thresholds, and collisions sample by sample.

Model and thresholds are kept as one file of plain arrays and JSON.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.bodies import Chain
from mcpilco.config import from_dict
from mcpilco.files import damaged, read_groups, write_groups
from mcpilco.identification.collision.config import ThresholdConfig
from mcpilco.identification.collision.features import CURRENT_TERMS, CurrentFeatures
from mcpilco.identification.collision.model import (
    CurrentConfig,
    CurrentModel,
    condition_currents,
    current_prior,
)
from mcpilco.identification.rigid_body import RigidBody
from mcpilco.recordings import ArmSamples, RunningSlope
from mcpilco.typing import InputError, McPilcoError, RunFolderError

_TAIL = 10
"""samples above a quantile that make it more than the luck of one"""


@dataclass(frozen=True)
class Thresholds:
    """sigma_CD of each joint, thesis section 4.2."""

    config: ThresholdConfig
    moving: Float[np.ndarray, " J"]
    """where the joint moves [A, or standard deviations]"""
    resting: Float[np.ndarray, " J"]
    """where it is quasi-static, in the same unit"""

    def __call__(self, model: CurrentModel, samples: ArmSamples) -> Float[np.ndarray, "N J"]:
        """The largest residuals of these samples that raise no alarm [A]."""
        limits = np.where(model.quiet(samples), self.resting, self.moving)
        return limits * model.std(samples) if self.config.rule == "deviations" else limits


def thresholds(
    model: CurrentModel, samples: ArmSamples, config: ThresholdConfig | None = None
) -> Thresholds:
    """The thresholds below which a share of these samples is.

    Samples that the model was fitted to give thresholds that are too low.

    Raises:
        InputError: the numbers make no sense, or there are too few samples for the quantile.

    Reference: thesis section 4.2 leaves the rule open; section 4.6.2 takes the maximum.
    Differs: a quantile, for the maximum is set by the few samples in which a joint breaks loose.
    """
    config = config or ThresholdConfig()
    _check(config, len(samples))
    size = np.abs(samples.i - model.mean(samples))
    if config.rule == "deviations":
        size = size / model.std(samples)
    still = model.quiet(samples)
    if not config.by_phase:
        both = np.quantile(size, config.quantile, axis=0, method="higher")
        return Thresholds(config, both, both)
    names = model.joints
    moving, resting = (
        np.array([_quantile(size[at[:, j], j], config, names[j], word) for j in range(len(names))])
        for at, word in ((~still, "moves"), (still, "rests"))
    )
    return Thresholds(config, moving, resting)


def _check(config: ThresholdConfig, count: int) -> None:
    if not 0.5 <= config.quantile <= 1.0:
        raise InputError(f"quantile must be within 0.5..1, got {config.quantile:g}; try 0.998.")
    if config.debounce < 1:
        raise InputError(f"debounce must be at least 1 sample, got {config.debounce}.")
    _require_tail(config, count, "")


def _require_tail(config: ThresholdConfig, count: int, when: str) -> None:
    needed = _TAIL / max(1.0 - config.quantile, 1e-12) if config.quantile < 1.0 else 100
    if count < needed:
        raise InputError(
            f"a quantile of {config.quantile:g} needs at least {needed:.0f} samples without "
            f"contact{when}, got {count}; record for longer, or lower the quantile."
        )


def _quantile(size: np.ndarray, config: ThresholdConfig, joint: str, word: str) -> float:
    _require_tail(config, len(size), f" in which {joint} {word}")
    return float(np.quantile(size, config.quantile, method="higher"))


def debounced(over: Bool[np.ndarray, "N J"], count: int) -> Bool[np.ndarray, "N J"]:
    """Where `over` has been true for this and the `count` - 1 samples before."""
    found = over.copy()
    for back in range(1, count):
        found[back:] &= over[:-back]
        found[:back] = False
    return found


_LATE = 1.5
"""sampling times after which a sample does not follow on the one before [-]"""


@dataclass(frozen=True)
class Sample:
    """Measurements and targets of a robot at one instant, a number for each of J joints."""

    time: float
    """[s]"""
    position: Float[np.ndarray, " J"]
    """[rad or m]"""
    current: Float[np.ndarray, " J"]
    """measured [A]"""
    target_position: Float[np.ndarray, " J"]
    """[rad or m]"""
    target_velocity: Float[np.ndarray, " J"]
    """[rad/s or m/s]"""
    target_current: Float[np.ndarray, " J"]
    """[A]"""
    velocity: Float[np.ndarray, " J"] | None = None
    """[rad/s or m/s]; None where it is not measured"""


@dataclass(frozen=True)
class Detection:
    """The detector's verdict on a sample, or on N that follow one another."""

    time: Float[np.ndarray, "*b"]
    """[s]"""
    expected: Float[np.ndarray, "*b J"]
    """current without a collision [A]"""
    residual: Float[np.ndarray, "*b J"]
    """current measured less expected [A]; NaN while derivatives are not known yet"""
    threshold: Float[np.ndarray, "*b J"]
    """what the residual must not exceed [A]"""
    joints: Bool[np.ndarray, "*b J"]
    """alarms: in which joints the residual has been too large for long enough"""
    resting: Bool[np.ndarray, "*b J"]
    """which joints are quasi-static"""

    @property
    def collision(self) -> Bool[np.ndarray, "*b"]:
        """An alarm in any joint."""
        return np.asarray(self.joints.any(axis=-1))


class CollisionDetector:
    """Compares each sample's currents with those expected without contact."""

    def __init__(self, model: CurrentModel, limits: Thresholds) -> None:
        self.model, self.limits = model, limits
        window = model.config.window
        self._velocity = RunningSlope(model.dt, window)
        self._acceleration = RunningSlope(model.dt, window)
        self.reset()

    def reset(self) -> None:
        """Forgets all samples, as when the robot was switched off."""
        self._velocity.reset()
        self._acceleration.reset()
        self._over = np.zeros(len(self.model.joints), dtype=int)
        self._last: float | None = None

    def update(self, sample: Sample) -> Detection:
        """The verdict on this sample; one that comes late, or out of order, begins anew.

        Raises:
            InputError: the sample does not fit the robot, or is not finite.
        """
        self._check(sample)
        if self._last is not None and not 0.0 < sample.time - self._last < _LATE * self.model.dt:
            self.reset()
        self._last, time = sample.time, np.array(sample.time)
        dq = self._velocity(sample.position) if sample.velocity is None else sample.velocity
        ddq = self._acceleration(dq)
        if not np.isfinite(ddq).all():
            unknown, no = np.full(len(dq), np.nan), np.zeros(len(dq), dtype=bool)
            return Detection(time, unknown, unknown, unknown, no, no)
        s, q = sample, sample.position
        errors = s.target_position - q, s.target_velocity - dq
        columns = (time, q, dq, ddq, *errors, s.target_current, s.current)
        row = ArmSamples(*(column[None] for column in columns))
        expected, threshold = self.model.mean(row)[0], self.limits(self.model, row)[0]
        residual = sample.current - expected
        self._over = np.where(np.abs(residual) >= threshold, self._over + 1, 0)
        joints = self._over >= self.limits.config.debounce
        return Detection(time, expected, residual, threshold, joints, self.model.quiet(row)[0])

    def _check(self, sample: Sample) -> None:
        J = len(self.model.joints)
        for name, value in vars(sample).items():
            if value is None:
                continue
            shape = () if name == "time" else (J,)
            if np.shape(value) != shape or not np.isfinite(value).all():
                raise InputError(
                    f"{name} must be finite numbers of shape {shape}, for the joints "
                    f"{', '.join(self.model.joints)}, got {np.asarray(value).tolist()}; stop the "
                    "robot, or leave the sample out."
                )


def detect(model: CurrentModel, limits: Thresholds, samples: ArmSamples) -> Detection:
    """The verdicts of a `CollisionDetector` on a whole recording, computed at once."""
    expected, threshold = model.mean(samples), limits(model, samples)
    residual = samples.i - expected
    over = np.abs(residual) >= threshold
    joints = np.zeros_like(over)
    late = np.diff(samples.time) >= _LATE * model.dt
    for part in np.split(np.arange(len(samples)), np.flatnonzero(late) + 1):
        joints[part] = debounced(over[part], limits.config.debounce)
    return Detection(samples.time, expected, residual, threshold, joints, model.quiet(samples))


@dataclass(frozen=True)
class Event:
    """Alarms that follow on one another."""

    start_s: float
    """first alarm [s]"""
    end_s: float
    """last alarm [s]"""
    joints: tuple[str, ...]
    """that raised it"""
    excess: float
    """greatest residual, in thresholds [-]"""
    resting: bool
    """whether the joint that raised it first was quasi-static then"""


def events(found: Detection, joints: Sequence[str], pause_s: float = 0.2) -> list[Event]:
    """The alarms of a recording, those less than a pause apart together."""
    at = np.flatnonzero(found.collision)
    if not len(at):
        return []
    gathered = []
    for rows in np.split(at, np.flatnonzero(np.diff(found.time[at]) > pause_s) + 1):
        some, first = np.any(found.joints[rows], axis=0).tolist(), found.joints[rows[0]]
        ratio = np.abs(found.residual[rows]) / found.threshold[rows]
        gathered.append(
            Event(
                start_s=float(found.time[rows[0]]),
                end_s=float(found.time[rows[-1]]),
                joints=tuple(name for name, yes in zip(joints, some, strict=True) if yes),
                excess=float(ratio.max()),
                resting=bool(found.resting[rows[0]][first].all()),
            )
        )
    return gathered


FORMAT = "mcpilco collision model 1"


def save_collision_model(path: str | Path, model: CurrentModel, limits: Thresholds) -> Path:
    """The path of the file written; equal models give equal bytes.

    Raises:
        RunFolderError: the file cannot be written.
    """
    body = model.features.body
    about = {
        "format": FORMAT,
        "dt": model.dt,
        "config": asdict(model.config),
        "thresholds": asdict(limits.config),
        "chain": asdict(body.chain),
    }
    groups = {
        "samples": vars(model.train),
        "robot": {"nominal": body.nominal},
        "limits": {"moving": limits.moving, "resting": limits.resting},
    }
    groups |= {f"gp{j}": gp.to_arrays() for j, gp in enumerate(model.gps)}
    return write_groups(Path(path), about, groups)


def load_collision_model(path: str | Path) -> tuple[CurrentModel, Thresholds]:
    """The model and thresholds in a file; nothing in it is executed.

    Raises:
        RunFolderError: the file is missing, damaged, or something else.
    """
    path = Path(path)
    about, groups = read_groups(path)
    if about.get("format") != FORMAT:
        raise RunFolderError(
            f"{path} is no model of `mcpilco collisions learn` ({FORMAT!r}), got "
            f"{about.get('format')!r}; name the file that it wrote."
        )
    try:
        config = CurrentConfig(**about["config"])
        chain = from_dict(Chain, about["chain"])
        features = CurrentFeatures(
            RigidBody(chain, CURRENT_TERMS, groups["robot"]["nominal"]),
            config.quiet_speed,
            config.gate,
        )
        gps = tuple(current_prior(features, config))
        for j, gp in enumerate(gps):
            gp.load_arrays(groups[f"gp{j}"])
        train = ArmSamples(**groups["samples"])
        model, _ = condition_currents(gps, train, features, float(about["dt"]), config)
        limits = Thresholds(ThresholdConfig(**about["thresholds"]), **groups["limits"])
        if not np.shape(limits.moving) == np.shape(limits.resting) == (features.joints,):
            raise ValueError("thresholds of another number of joints")
    except (KeyError, TypeError, ValueError, IndexError, McPilcoError) as error:
        raise damaged(path, error) from error
    return model, limits
