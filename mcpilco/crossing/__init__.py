"""Whether a policy crosses the gap: what the simulation it was trained in promised, what came."""

from mcpilco.crossing.outcomes import (
    Crossing,
    Outcome,
    Place,
    cross,
    read_crossing,
    write_crossing,
)
from mcpilco.crossing.prior import as_mean, remembered_inputs

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
