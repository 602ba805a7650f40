"""Measured recordings: log files become states and inputs on a uniform grid, with their noise."""

from mcpilco.recordings.from_rollout import from_rollout
from mcpilco.recordings.noise import noise_std
from mcpilco.recordings.reader import read_recording, read_recordings
from mcpilco.recordings.recording import Recording, write_recording
from mcpilco.recordings.smoothing import smoothed

__all__ = [
    "Recording",
    "from_rollout",
    "noise_std",
    "read_recording",
    "read_recordings",
    "smoothed",
    "write_recording",
]
