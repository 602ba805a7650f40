from .delay import Delay, turning_regressors
from .dynamics import GPDynamics, Increment, full_state, regressors, speed_integration
from .features import AngleAugmentation, JointPolynomials, friction
from .linearisation import Course, Linearised, linearised, linearised_along
from .pathwise import PathwisePosterior
from .physics import PhysicsDraw, PhysicsDynamics, PhysicsMean

__all__ = [
    "AngleAugmentation",
    "Course",
    "Delay",
    "GPDynamics",
    "Increment",
    "JointPolynomials",
    "Linearised",
    "PathwisePosterior",
    "PhysicsDraw",
    "PhysicsDynamics",
    "PhysicsMean",
    "friction",
    "full_state",
    "linearised",
    "linearised_along",
    "regressors",
    "speed_integration",
    "turning_regressors",
]
