"""How well a learned forward kinematics predicts the frames that it was not fitted to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from mcpilco.identification.kinematics.forward import ForwardKinematics
from mcpilco.recordings import MarkerRecording, rotation


@dataclass(frozen=True, eq=False)
class Errors:
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


def validate(model: ForwardKinematics, recording: MarkerRecording) -> Errors | None:
    """Errors on the frames whose joint positions are not among the model's; None without any."""
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
    measured = rotation(recording.quaternions[rows, place]).as_matrix()
    cosine = (np.einsum("nij,nij->n", measured, R) - 1.0) / 2.0
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    return Errors(recording.time[rows], recording.positions[rows, place] - p, angle)
