from .estimators import (
    ESTIMATORS,
    fit_inverse_dynamics,
    load_inverse_dynamics,
    save_inverse_dynamics,
)
from .model import FeedForward, Inertia, InverseDynamics, accelerations, inertia

__all__ = [
    "ESTIMATORS",
    "FeedForward",
    "Inertia",
    "InverseDynamics",
    "accelerations",
    "fit_inverse_dynamics",
    "inertia",
    "load_inverse_dynamics",
    "save_inverse_dynamics",
]
