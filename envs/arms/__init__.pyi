from .motions import Sinusoids, random_sinusoids
from .robots import (
    ARMS,
    Followed,
    Gains,
    control_times,
    follow,
    load,
    measured,
    record_sinusoids,
)

__all__ = [
    "ARMS",
    "Followed",
    "Gains",
    "Sinusoids",
    "control_times",
    "follow",
    "load",
    "measured",
    "random_sinusoids",
    "record_sinusoids",
]
