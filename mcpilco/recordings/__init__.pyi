from .collision_samples import WINDOW, ArmSamples, RunningSlope
from .collisions import FORCE, ArmRecording, columns_of, read_arm, samples_of
from .excitations import PARTS, Part, excitation
from .inverse_dynamics import held_out, joint_data, joints_in, kinds_of, read_joint_recordings
from .inverse_dynamics_data import ARRAYS, JointData, check, joined
from .marker_reader import read_markers, write_markers
from .markers import MarkerRecording, marker_recording, rotation
from .noise import noise_std
from .reader import read_recording, read_recordings
from .recording import Recording, runs, write_recording
from .robot_log import Segment, load_robot, read_robot
from .rollouts import from_rollout
from .series import Series, lagged, read_series, suspicions, usable
from .smoothing import smoothed
from .stamps import sampling_time

__all__ = [
    "ARRAYS",
    "FORCE",
    "PARTS",
    "WINDOW",
    "ArmRecording",
    "ArmSamples",
    "JointData",
    "MarkerRecording",
    "Part",
    "Recording",
    "RunningSlope",
    "Segment",
    "Series",
    "check",
    "columns_of",
    "excitation",
    "from_rollout",
    "held_out",
    "joined",
    "joint_data",
    "joints_in",
    "kinds_of",
    "lagged",
    "load_robot",
    "marker_recording",
    "noise_std",
    "read_arm",
    "read_joint_recordings",
    "read_markers",
    "read_recording",
    "read_recordings",
    "read_robot",
    "read_series",
    "rotation",
    "runs",
    "samples_of",
    "sampling_time",
    "smoothed",
    "suspicions",
    "usable",
    "write_markers",
    "write_recording",
]
