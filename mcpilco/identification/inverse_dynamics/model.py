"""What every model of a robot's inverse dynamics can do."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.identification.inverse_dynamics.data import JointData
from mcpilco.identification.report import Report


class InverseDynamics(ABC):
    """The torques that a motion takes, learned from data: tau(q, q', q'')."""

    kernel: str
    """by which name it is built and saved, a key of `ESTIMATORS`"""
    joints: tuple[str, ...]
    """names, in the order of q"""
    report: Report
    """how the fit went"""

    @abstractmethod
    def __call__(self, motion: Float[Tensor, "*b 3J"]) -> Float[Tensor, "*b J"]:
        """Torques of motions [q, q', q''] of any batch shape, differentiable by the motion.

        Args:
            motion: positions, velocities and accelerations, side by side [rad or m, by s].
        """

    @abstractmethod
    def to_groups(self) -> tuple[dict[str, Any], dict[str, dict[str, np.ndarray]]]:
        """Everything learned, as plain JSON and named arrays: what `load` reads."""

    def nmse(self, data: JointData) -> Float[np.ndarray, " J"]:
        """Mean squared error of each joint, in parts of the variance of its torque [-].

        Reference: thesis section 3.4.1.
        """
        with torch.no_grad():
            errors = self(data.motion).numpy() - data.tau
        return np.mean(errors**2, 0) / np.var(data.tau, 0)


def about(model: InverseDynamics, **more: Any) -> dict[str, Any]:
    """What a file says of a model, besides its arrays."""
    fit = {
        "converged": model.report.converged,
        "iterations": model.report.iterations,
        "evidence": list(model.report.evidence),
        "jitter": list(model.report.jitter),
        "unidentified": list(model.report.unidentified),
        "warnings": list(model.report.warnings),
    }
    return {"kernel": model.kernel, "joints": list(model.joints), "report": fit, **more}


def report_of(about: Mapping[str, Any]) -> Report:
    """The report that `about` wrote."""
    fit = dict(about["report"])
    lists = ("evidence", "jitter", "unidentified", "warnings")
    return Report(**(fit | {name: tuple(fit[name]) for name in lists}))
