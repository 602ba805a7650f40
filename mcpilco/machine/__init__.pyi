from .env import MACHINE, MachineEnv, MachineSettings, machine_of, meeting
from .protocol import (
    LARGEST,
    Frame,
    Inbox,
    Kind,
    Mode,
    RefusedError,
    Status,
    decode,
    encode,
    stuffed,
    unstuffed,
)

__all__ = [
    "LARGEST",
    "MACHINE",
    "Frame",
    "Inbox",
    "Kind",
    "MachineEnv",
    "MachineSettings",
    "Mode",
    "RefusedError",
    "Status",
    "decode",
    "encode",
    "machine_of",
    "meeting",
    "stuffed",
    "unstuffed",
]
