"""Robot arms for identification: their models, what moves them, and what their sensors see."""

from envs.arms.control import Followed, Gains, control_times, follow
from envs.arms.models import ARMS, load
from envs.arms.recording import measured, record_sinusoids
from envs.arms.sinusoids import Sinusoids, random_sinusoids

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
