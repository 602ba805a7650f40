from . import fused
from .engine import compiled_before, rollout_of
from .fused.arithmetic import OUTERMOST, PLAIN, set_exponentials
from .fused.tiles import TALL, multiply, multiply_lower, multiply_upper, pack, strip
from .particles import Particles, Problem, RolloutFunction, rollout
from .search import Candidate, Descent, PolicySearch, SearchResult, Starts, adam, follow

__all__ = [
    "OUTERMOST",
    "PLAIN",
    "TALL",
    "Candidate",
    "Descent",
    "Particles",
    "PolicySearch",
    "Problem",
    "RolloutFunction",
    "SearchResult",
    "Starts",
    "adam",
    "compiled_before",
    "follow",
    "fused",
    "multiply",
    "multiply_lower",
    "multiply_upper",
    "pack",
    "rollout",
    "rollout_of",
    "set_exponentials",
    "strip",
]
