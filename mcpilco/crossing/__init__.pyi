from .outcomes import Crossing, Outcome, Place, cross, read_crossing, write_crossing
from .rollouts import record_rollouts
from .workflow import LEGS, CrossingSettings, Workflow, as_mean, remembered_inputs

__all__ = [
    "LEGS",
    "Crossing",
    "CrossingSettings",
    "Outcome",
    "Place",
    "Workflow",
    "as_mean",
    "cross",
    "read_crossing",
    "record_rollouts",
    "remembered_inputs",
    "write_crossing",
]
