"""The Fisherian estimator: one vector of parameters for all joints, by least squares."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.identification.base_parameters import base_parameters
from mcpilco.identification.inverse_dynamics.model import Fitted, InverseDynamics
from mcpilco.identification.inverse_dynamics.physics import PhysicalFeatures
from mcpilco.identification.report import Report
from mcpilco.recordings import JointData


class LinearInverseDynamics(InverseDynamics):
    """tau = Phi(q, q', q'') w with one w for all joints: eq. (3.2)."""

    def __init__(
        self, fitted: Fitted, features: PhysicalFeatures, w: Float[np.ndarray, " D"]
    ) -> None:
        super().__init__(fitted)
        self.features, self.w = features, w

    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        return self.features(motion) @ torch.as_tensor(self.w)

    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        return {"parameters": {"w": self.w}}


def fit_least_squares(
    data: JointData, features: PhysicalFeatures, **built: Any
) -> LinearInverseDynamics:
    """The least w of all that explain the torques of all joints best.

    `report.unidentified` names the parameters whose columns depend on others in these data.

    Reference: thesis section 3.4.1; Sousa, Cortesão, Physical feasibility of robot base inertial
    parameter identification, International Journal of Robotics Research 33 (6), 2014.
    """
    Phi = features(data.motion).numpy()
    rows = Phi.reshape(-1, Phi.shape[-1])
    w = np.linalg.lstsq(rows, data.tau.ravel(), rcond=1e-9)[0]
    dependent = base_parameters(Phi).dependent
    names = tuple(features.names[column] for column in dependent)
    report = Report(converged=True, iterations=0, unidentified=names)
    return LinearInverseDynamics(Fitted.to("fe", data, report, **built), features, w)
