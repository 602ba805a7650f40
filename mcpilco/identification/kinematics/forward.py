"""Forward kinematics learned from a camera: from joint positions to the pose of a link's marker."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import cast

import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation
from torch import Tensor

from mcpilco.files import damaged, read_groups, write_groups
from mcpilco.gp import GP, FitReport, Posterior
from mcpilco.identification.kinematics.chain import KinematicChain
from mcpilco.identification.report import Report, jitter_of
from mcpilco.kernels import Kernel, Kinematic, NestedKinematic
from mcpilco.recordings import MarkerRecording, kinds_of, rotation
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)

KERNELS: dict[str, Callable[[Sequence[str], Sequence[int]], Kernel]] = {
    "nested": NestedKinematic,
    "product": Kinematic,
}
"""priors by name: with the order of the joints, and the thesis' (2.22) and (2.23) without"""
POSE_OUTPUTS = ("x", "y", "z", "R11", "R21", "R31", "R12", "R22", "R32")
"""what is learned: the position [m] and two columns of the rotation matrix [-]"""
_NOISE_FLOOR = 1e-5
"""least noise of an output [m or -]"""
_FEWEST = 10
_FAR, _CLEANINGS = 6.0, 5
"""beyond so many robust standard deviations a sample is wrong; how often such are sought"""
FORMAT = 1


@dataclass(frozen=True, eq=False)
class ForwardKinematics:
    """The pose of a chain's last marker as a function of the joints of the chain."""

    joints: tuple[str, ...]
    """from the base to the tip: the order of `q`"""
    kinds: tuple[str, ...]
    """`hinge` or `slide`"""
    marker: str
    """whose pose it is"""
    kernel: str
    """of `KERNELS`"""
    gp: GP
    q: Float[Tensor, "N J"]
    """joint positions of the samples [rad or m]"""
    Y: Float[Tensor, "N E"]
    """their `POSE_OUTPUTS`"""
    report: Report

    @cached_property
    def posterior(self) -> Posterior:
        """Of the outputs less their mean over the samples."""
        return self.gp.condition(regressors(self.q, self.kinds), self.Y - self.Y.mean(0))

    def pose(
        self, q: Float[Tensor, "*b J"]
    ) -> tuple[Float[Tensor, "*b 3"], Float[Tensor, "*b 3 3"]]:
        """Position [m] and rotation matrix in the camera's frame, differentiable in q.

        Positions q are in the order of `joints` [rad or m].

        Reference: thesis section 2.5.3.
        Differs: the thesis learns five entries of the matrix and computes yaw, pitch and roll, of
        which two are lost near a pitch of 90 degrees. Here two columns are made orthonormal.
        """
        X = regressors(q, self.kinds)
        K = self.posterior.kernel(X.reshape(-1, X.shape[-1]), self.posterior.X)  # E M N
        Y = (K @ self.posterior.alpha[..., None])[..., 0].mT + self.Y.mean(0)
        Y = Y.reshape(*q.shape[:-1], len(POSE_OUTPUTS))
        return Y[..., :3], orthonormal(Y[..., 3:6], Y[..., 6:9])

    def position_std(self, q: Float[Tensor, "N J"]) -> Float[Tensor, "N 3"]:
        """Posterior standard deviation of the position, without the noise [m]."""
        _, variance = self.posterior.mean_and_variance(regressors(q, self.kinds))
        return variance[:, :3].sqrt()

    def save(self, path: str | Path) -> Path:
        """Write the model as an `.npz` of plain arrays, which `load` reads.

        Raises:
            RunFolderError: the file cannot be written.
        """
        about = {name: getattr(self, name) for name in ("joints", "kinds", "marker", "kernel")}
        data = {"q": self.q.numpy(), "Y": self.Y.numpy()}
        groups = {"data": data, "gp": self.gp.to_arrays()}
        return write_groups(Path(path), {"format": FORMAT, **about}, groups)

    @classmethod
    def load(cls, path: str | Path) -> ForwardKinematics:
        """The model that `save` wrote; its report is empty.

        Raises:
            RunFolderError: the file is missing, damaged or of another kind.
        """
        about, groups = read_groups(Path(path))
        try:
            kinds, joints = kinds_of(about["kinds"]), tuple(about["joints"])
            gp = _gp(about["kernel"], kinds)
            gp.load_arrays(groups["gp"])
            data = {name: torch.as_tensor(groups["data"][name]) for name in ("q", "Y")}
            report = Report(converged=True, iterations=0)
            marker, kernel = str(about["marker"]), about["kernel"]
            model = cls(joints, kinds, marker, kernel, gp, **data, report=report)
            _ = model.posterior  # raises where the samples do not fit
            return model
        except (KeyError, TypeError, ValueError, InputError) as error:
            raise damaged(Path(path), error) from error


def fit_forward(
    recording: MarkerRecording,
    chain: KinematicChain,
    samples: int = 300,
    kernel: str = "nested",
    seed: int = 0,
) -> ForwardKinematics:
    """Learn the pose of the chain's last marker by maximal marginal likelihood.

    Samples that the others contradict, by leave-one-out prediction, are left out as outliers.

    The recording is what `chain` was found in, or another one of the same robot. So many `samples`
    are drawn at random from those that show the marker; the work grows with their third power. The
    kernel is one of `KERNELS`.

    Raises:
        InputError: the marker is seen too rarely, or the kernel is unknown.

    Reference: thesis section 2.5.3.
    Differs: two columns of the rotation matrix in place of five entries; all outputs less their
    mean; one kernel for positions and orientations, with hyperparameters of their own.
    """
    if kernel not in KERNELS:
        raise InputError(f"kernel must be one of {', '.join(KERNELS)}, got {kernel!r}.")
    marker = chain.markers[-1]
    rows = rows_for_fit(recording, marker, samples, seed)
    joints = tuple(joint.name for joint in chain.joints)
    q, Y = (part[rows] for part in pose_samples(recording, joints, marker))
    kinds = tuple(joint.kind for joint in chain.joints)
    gp, kept = _fit_without_outliers(kernel, kinds, q, Y)
    left_out = int((~kept).sum())
    q, Y = q[kept], Y[kept]
    warnings = []
    if not cast(FitReport, gp.report).converged:
        warnings.append("the marginal likelihood was still rising when the fit was stopped.")
    if left_out:
        warnings.append(f"{left_out} samples contradict all others and are left out.")
    jitter = jitter_of(gp.condition(regressors(q, kinds), Y))
    report = Report.of_gps([gp], jitter=jitter, warnings=tuple(warnings))
    return ForwardKinematics(joints, kinds, marker, kernel, gp, q, Y, report)


def rows_for_fit(recording: MarkerRecording, marker: str, samples: int, seed: int) -> np.ndarray:
    """Frames that show the marker, so many of them as are asked for, in order of time."""
    seen = np.flatnonzero(recording.seen[:, recording.marker_names.index(marker)])
    if min(len(seen), samples) < _FEWEST:
        raise InputError(
            f"expected at least {_FEWEST} samples for the forward kinematics, got {samples} of "
            f"{len(seen)} that show the marker {marker}; record more, or ask for more."
        )
    if len(seen) <= samples:
        return seen
    return np.sort(np.random.default_rng(seed).choice(seen, samples, replace=False))


def pose_samples(
    recording: MarkerRecording, joints: Sequence[str], marker: str
) -> tuple[Float[Tensor, "N J"], Float[Tensor, "N E"]]:
    """Joint positions in this order, and `POSE_OUTPUTS`, NaN where the marker is not seen."""
    columns = [recording.joint_names.index(name) for name in joints]
    place = recording.marker_names.index(marker)
    Y = np.full((len(recording), len(POSE_OUTPUTS)), np.nan)
    seen = recording.seen[:, place]
    R = rotation(recording.quaternions[seen, place]).as_matrix()
    Y[seen] = np.concatenate([recording.positions[seen, place], R[:, :, 0], R[:, :, 1]], axis=1)
    return torch.as_tensor(recording.q[:, columns]), torch.as_tensor(Y)


def regressors(q: Float[Tensor, "*b J"], kinds: Sequence[str]) -> Float[Tensor, "*b D"]:
    """Cosines and sines of hinges, then positions of slides (thesis eq. 2.21)."""
    turns = [k for k, kind in enumerate(kinds) if kind == "hinge"]
    slides = [k for k, kind in enumerate(kinds) if kind == "slide"]
    return torch.cat([q[..., turns].cos(), q[..., turns].sin(), q[..., slides]], -1)


def _gp(kernel: str, kinds: Sequence[str]) -> GP:
    prior = KERNELS[kernel](kinds, (len(POSE_OUTPUTS),))
    return GP(prior, noise_floor=_NOISE_FLOOR, names=POSE_OUTPUTS)


def orthonormal(
    first: Float[Tensor, "*b 3"], second: Float[Tensor, "*b 3"]
) -> Float[Tensor, "*b 3 3"]:
    """The rotation matrix with these first two columns, made orthonormal one after the other."""
    x = first / first.norm(dim=-1, keepdim=True)
    y = second - (x * second).sum(-1, keepdim=True) * x
    y = y / y.norm(dim=-1, keepdim=True)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)


def _fit_without_outliers(
    kernel: str, kinds: Sequence[str], q: Float[Tensor, "N J"], Y: Float[Tensor, "N E"]
) -> tuple[GP, Bool[np.ndarray, " N"]]:
    """The GP, and which samples it was fitted to: fit, leave out the contradicted, fit again."""
    kept = np.ones(len(q), dtype=bool)
    X = regressors(q, kinds)
    for _ in range(_CLEANINGS):
        gp = _gp(kernel, kinds)
        y = Y[kept] - Y[kept].mean(0)
        posterior = gp.fit(X[kept], y).condition(X[kept], y)
        right = _trusted(posterior)
        if right.all() or right.sum() < _FEWEST:
            break
        kept[np.flatnonzero(kept)[~right]] = False
    return gp, kept


def _trusted(posterior: Posterior) -> Bool[np.ndarray, " N"]:
    """Which samples agree with what the others predict of them.

    The leave-one-out residual is alpha_i / [K^-1]_ii with variance 1 / [K^-1]_ii (R&W eq. 5.12);
    its unit is the median of their magnitudes, which wrong samples hardly change.
    """
    precision = posterior.L_inv.square().sum(-2)
    z = (posterior.alpha / precision.sqrt()).abs()
    unit = 1.4826 * z.median(-1, keepdim=True).values
    return (z <= _FAR * unit).all(0).numpy()


@dataclass(frozen=True, eq=False)
class PoseErrors:
    """Measured pose less predicted one; the noise of the measurement is part of it."""

    time: Float[np.ndarray, " N"]
    """of the frames [s]"""
    position: Float[np.ndarray, "N 3"]
    """[m]"""
    angle: Float[np.ndarray, " N"]
    """of the rotation between the two [rad]"""

    @property
    def position_median(self) -> Float[np.ndarray, " 3"]:
        """Of the magnitude on each axis [m]; wrong poses hardly change it."""
        return np.median(np.abs(self.position), axis=0)

    @property
    def angle_median(self) -> float:
        """The median of the angles [rad]."""
        return float(np.median(self.angle))

    def summary(self) -> dict[str, object]:
        """Numbers for a file."""
        return {
            "samples": len(self.time),
            "position_median_m": self.position_median.tolist(),
            "position_rms_m": np.sqrt((self.position**2).mean(0)).tolist(),
            "angle_median_rad": self.angle_median,
            "angle_rms_rad": float(np.sqrt((self.angle**2).mean())),
        }


def prediction_errors(model: ForwardKinematics, recording: MarkerRecording) -> PoseErrors | None:
    """Errors on frames whose joint positions are not among the model's; None without any."""
    columns = [recording.joint_names.index(name) for name in model.joints]
    place = recording.marker_names.index(model.marker)
    used = {row.tobytes() for row in model.q.numpy()}
    q = recording.q[:, columns]
    new = np.array([row.tobytes() not in used for row in q])
    rows = np.flatnonzero(new & recording.seen[:, place])
    if not len(rows):
        return None
    with torch.no_grad():
        p, R = (value.numpy() for value in model.pose(torch.as_tensor(q[rows])))
    off = rotation(recording.quaternions[rows, place]).inv() * Rotation.from_matrix(R)
    position = recording.positions[rows, place] - p
    return PoseErrors(recording.time[rows], position, off.magnitude())
