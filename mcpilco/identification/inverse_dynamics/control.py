"""Feed-forward control: the torques that a plan takes, before anything goes wrong."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float

from mcpilco.identification.inverse_dynamics.model import InverseDynamics
from mcpilco.typing import InputError


@dataclass(frozen=True, eq=False)
class FeedForward:
    """tau = model(q_d, q'_d, q''_d) + K_p (q_d - q) + K_d (q'_d - q').

    The model gives what the planned motion takes, the feedback mends what it gets wrong. Without a
    model it is a PD controller.

    Reference: Siciliano et al., Robotics: Modelling, Planning and Control (2009), section 8.5.
    """

    model: InverseDynamics | None
    """None: feedback alone"""
    proportional: Float[np.ndarray, " J"]
    """K_p [N m/rad or N/m]"""
    derivative: Float[np.ndarray, " J"]
    """K_d [N m s/rad or N s/m]"""

    def __post_init__(self) -> None:
        for name in ("proportional", "derivative"):
            gains = np.asarray(getattr(self, name))
            if gains.ndim != 1 or not (np.isfinite(gains) & (gains >= 0)).all():
                raise InputError(
                    f"FeedForward.{name} must be a gain >= 0 for each joint, got {gains.tolist()}."
                )

    def plan(
        self,
        q: Float[np.ndarray, "T J"],
        dq: Float[np.ndarray, "T J"],
        ddq: Float[np.ndarray, "T J"],
    ) -> Float[np.ndarray, "T J"]:
        """Torques of a planned motion [N m or N]: once, before it begins."""
        if self.model is None:
            return np.zeros_like(q)
        with torch.no_grad():
            motion = torch.as_tensor(np.concatenate([q, dq, ddq], -1), dtype=torch.float64)
            return self.model(motion).numpy()

    def torque(
        self,
        planned: Float[np.ndarray, "*#b J"],
        q_error: Float[np.ndarray, "*#b J"],
        dq_error: Float[np.ndarray, "*#b J"],
    ) -> Float[np.ndarray, "*#b J"]:
        """What to command [N m or N].

        Args:
            planned: a row of `plan`.
            q_error: q_d - q [rad or m].
            dq_error: q'_d - q' [rad/s or m/s].
        """
        return planned + self.proportional * q_error + self.derivative * dq_error
