from .chain import ChainJoint, KinematicChain, Tolerance, find_chain, scores
from .controller import Path, Reach, reach
from .forward import ForwardKinematics, PoseErrors, fit_forward, prediction_errors
from .triplets import TripletTests, triplet_tests

__all__ = [
    "ChainJoint",
    "ForwardKinematics",
    "KinematicChain",
    "Path",
    "PoseErrors",
    "Reach",
    "Tolerance",
    "TripletTests",
    "find_chain",
    "fit_forward",
    "prediction_errors",
    "reach",
    "scores",
    "triplet_tests",
]
