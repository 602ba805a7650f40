from . import fused
from .engine import Loop, compile_only, compiled_before, rollout_of
from .fused.arithmetic import OUTERMOST, PLAIN, set_exponentials
from .fused.tiles import TALL, multiply, multiply_lower, multiply_upper, pack, strip
from .limits import EXPLORED, Lagrangian, Limits
from .particles import Particles, Problem, RolloutFunction, rollout
from .search import Adam, Candidate, Descent, PolicySearch, SearchResult, Starts, follow

__all__ = [
    "EXPLORED",
    "OUTERMOST",
    "PLAIN",
    "TALL",
    "Adam",
    "Candidate",
    "Descent",
    "Lagrangian",
    "Limits",
    "Loop",
    "Particles",
    "PolicySearch",
    "Problem",
    "RolloutFunction",
    "SearchResult",
    "Starts",
    "compile_only",
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
