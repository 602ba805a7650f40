"""Robot arms for identification: their models, what moves them, and what their sensors see."""

from envs.arms.motions import Sinusoids, random_sinusoids
from envs.arms.robots import (
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
