from .chain import ChainJoint, KinematicChain, Tolerance, find_chain, scores
from .controller import Path, Reach, reach
from .forward import (
    POSE_OUTPUTS,
    ForwardKinematics,
    PoseErrors,
    fit_forward,
    orthonormal,
    pose_samples,
    prediction_errors,
    rows_for_fit,
)
from .geometry import chain_in_space
from .triplets import TripletTests, triplet_tests

__all__ = [
    "POSE_OUTPUTS",
    "ChainJoint",
    "ForwardKinematics",
    "KinematicChain",
    "Path",
    "PoseErrors",
    "Reach",
    "Tolerance",
    "TripletTests",
    "chain_in_space",
    "find_chain",
    "fit_forward",
    "orthonormal",
    "pose_samples",
    "prediction_errors",
    "reach",
    "rows_for_fit",
    "scores",
    "triplet_tests",
]
