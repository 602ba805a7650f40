from .outcomes import Crossing, Outcome, Place, cross, read_crossing, write_crossing
from .prior import as_mean, remembered_inputs

__all__ = [
    "Crossing",
    "Outcome",
    "Place",
    "as_mean",
    "cross",
    "read_crossing",
    "remembered_inputs",
    "write_crossing",
]
