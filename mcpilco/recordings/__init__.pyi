from .arms import (
    FORCE,
    WINDOW,
    ArmRecording,
    ArmSamples,
    RunningSlope,
    arm_samples,
    columns_of,
    read_arm,
)
from .excitations import PARTS, Part, excitation
from .for_plant import read_for_plant
from .joints import (
    ARRAYS,
    JointData,
    check_joint_data,
    held_out,
    joint_data,
    joints_in,
    kinds_of,
    read_joint_recordings,
)
from .markers import MarkerRecording, marker_recording, read_markers, rotation, write_markers
from .noise import NoiseFilter, Whitening, following
from .reader import read_recording, read_recordings
from .recording import Recording, bridged, from_rollout, runs, write_recording
from .resample import sampling_time
from .robot_log import (
    JointMotion,
    Segment,
    encoder_noise,
    load_robot,
    local_cubics,
    motion_cutoff,
    read_robot,
    zero_phase,
)
from .series import Series, lagged, read_series, suspicions, usable
from .smoothing import first_state, noise_std, smoothed, states_at_commands
from .suspicion import doubts

__all__ = [
    "ARRAYS",
    "FORCE",
    "PARTS",
    "WINDOW",
    "ArmRecording",
    "ArmSamples",
    "JointData",
    "JointMotion",
    "MarkerRecording",
    "NoiseFilter",
    "Part",
    "Recording",
    "RunningSlope",
    "Segment",
    "Series",
    "Whitening",
    "arm_samples",
    "bridged",
    "check_joint_data",
    "columns_of",
    "doubts",
    "encoder_noise",
    "excitation",
    "first_state",
    "following",
    "from_rollout",
    "held_out",
    "joint_data",
    "joints_in",
    "kinds_of",
    "lagged",
    "load_robot",
    "local_cubics",
    "marker_recording",
    "motion_cutoff",
    "noise_std",
    "read_arm",
    "read_for_plant",
    "read_joint_recordings",
    "read_markers",
    "read_recording",
    "read_recordings",
    "read_robot",
    "read_series",
    "rotation",
    "runs",
    "sampling_time",
    "smoothed",
    "states_at_commands",
    "suspicions",
    "usable",
    "write_markers",
    "write_recording",
    "zero_phase",
]
