from .estimators import (
    ESTIMATORS,
    fit_inverse_dynamics,
    load_inverse_dynamics,
    save_inverse_dynamics,
)
from .gaussian import NOISE_FLOORS, fit_gaussian, geometric
from .model import FeedForward, Inertia, InverseDynamics, accelerations, inertia

__all__ = [
    "ESTIMATORS",
    "NOISE_FLOORS",
    "FeedForward",
    "Inertia",
    "InverseDynamics",
    "accelerations",
    "fit_gaussian",
    "fit_inverse_dynamics",
    "geometric",
    "inertia",
    "load_inverse_dynamics",
    "save_inverse_dynamics",
]
