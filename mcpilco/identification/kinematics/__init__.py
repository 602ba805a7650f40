"""The kinematics of a robot from what a camera sees: its chain, and where its tip is."""

from mcpilco.identification.kinematics.chain import Chain, Joint, Tolerance, find_chain
from mcpilco.identification.kinematics.controller import Path, Reach, reach
from mcpilco.identification.kinematics.forward import ForwardKinematics, fit_forward
from mcpilco.identification.kinematics.triplets import TripletTests, triplet_tests
from mcpilco.recordings import MarkerRecording, marker_recording, read_markers, write_markers

__all__ = [
    "Chain",
    "ForwardKinematics",
    "Joint",
    "MarkerRecording",
    "Path",
    "Reach",
    "Tolerance",
    "TripletTests",
    "find_chain",
    "fit_forward",
    "marker_recording",
    "reach",
    "read_markers",
    "triplet_tests",
    "write_markers",
]
