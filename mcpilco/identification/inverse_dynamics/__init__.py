"""Inverse dynamics learned from data: which torques a motion takes.

Reference: thesis chapter 3.
"""

from mcpilco.identification.inverse_dynamics.control import FeedForward
from mcpilco.identification.inverse_dynamics.estimators import ESTIMATORS, fit, load, save
from mcpilco.identification.inverse_dynamics.forward import Inertia, accelerations, inertia
from mcpilco.identification.inverse_dynamics.model import InverseDynamics
from mcpilco.recordings import JointData, check, joined

__all__ = [
    "ESTIMATORS",
    "FeedForward",
    "Inertia",
    "InverseDynamics",
    "JointData",
    "accelerations",
    "check",
    "fit",
    "inertia",
    "joined",
    "load",
    "save",
]
