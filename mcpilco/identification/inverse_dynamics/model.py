"""What every model of a robot's inverse dynamics can do.

A motion [q, q', q''] of J joints has a width of Q = 3 J.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.identification.report import Report
from mcpilco.recordings import JointData
from mcpilco.typing import InputError


@dataclass(frozen=True)
class Fitted:
    """What every model knows of its fit, and a file says of it."""

    kernel: str
    """by which name it is built, a key of `ESTIMATORS`"""
    joints: tuple[str, ...]
    """names, in the order of q"""
    torque_std: tuple[float, ...]
    """standard deviation of each joint's torque in the data [N m or N]"""
    report: Report
    """how it went"""
    built: Mapping[str, Any] = field(default_factory=dict)
    """what else a file must say to build the model anew"""

    @classmethod
    def to(cls, kernel: str, data: JointData, report: Report, **built: Any) -> Fitted:
        """A model that was fitted to data."""
        as_read = json.loads(json.dumps(built))  # equal before and after a file
        return cls(kernel, data.joints, tuple(data.tau.std(0).tolist()), report, as_read)

    def to_json(self) -> dict[str, Any]:
        """What `of_json` reads."""
        return asdict(self)

    @classmethod
    def of_json(cls, saved: Mapping[str, Any]) -> Fitted:
        """What `to_json` wrote."""
        report: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in saved["report"].items()
        }
        return cls(
            saved["kernel"],
            tuple(saved["joints"]),
            tuple(saved["torque_std"]),
            Report(**report),
            saved["built"],
        )


class InverseDynamics(ABC):
    """The torques that a motion takes, learned from data: tau(q, q', q'').

    Args:
        fitted: what all models know of their fit.
    """

    def __init__(self, fitted: Fitted) -> None:
        self.fitted = fitted

    @property
    def joints(self) -> tuple[str, ...]:
        """Names, in the order of q."""
        return self.fitted.joints

    @property
    def report(self) -> Report:
        """How the fit went."""
        return self.fitted.report

    @abstractmethod
    def __call__(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"]:
        """Torques of motions [q, q', q''] of any batch shape, differentiable by the motion.

        Args:
            motion: positions, velocities and accelerations, side by side [rad or m, by s].
        """

    @abstractmethod
    def to_groups(self) -> dict[str, dict[str, np.ndarray]]:
        """Everything learned, as named arrays: what `load` reads."""

    def std(self, motion: Float[Tensor, "*b Q"]) -> Float[Tensor, "*b J"] | None:
        """Standard deviation of the torques, without the noise; None of models without one."""
        return None

    def nmse(self, data: JointData) -> Float[np.ndarray, " J"]:
        """Mean squared error of each joint, in parts of the variance of its torque [-].

        Raises:
            InputError: a torque does not vary in these data.

        Reference: thesis section 3.4.1.
        """
        for joint, variance in zip(data.joints, data.tau.var(0), strict=True):
            if not variance > 0.0:
                raise InputError(
                    f"the torque of joint {joint!r} is constant in the test data, so its error has "
                    "no scale; test on a motion that moves every joint."
                )
        with torch.no_grad():
            errors = self(data.motion).numpy() - data.tau
        return np.mean(errors**2, 0) / np.var(data.tau, 0)
