"""Whether a policy crosses the gap: what the simulation it was trained in promised, what came."""

from mcpilco.crossing.film import write_film
from mcpilco.crossing.outcomes import (
    Crossing,
    Outcome,
    Place,
    cross,
    read_crossing,
    write_crossing,
)

__all__ = [
    "Crossing",
    "Outcome",
    "Place",
    "cross",
    "read_crossing",
    "write_crossing",
    "write_film",
]
