from . import batched, fused
from .batched.engine import rollout_batch
from .batched.masks import MaskBatch
from .batched.model import ModelBatch
from .batched.policy import PolicyBatch
from .continuation import follow
from .engine import rollout_of, warn_without_numba
from .fused.arithmetic import OUTERMOST, PLAIN, set_exponentials
from .fused.tiles import TALL, multiply, multiply_lower, multiply_upper, pack, strip
from .particles import Particles, Problem, RolloutFunction, rollout
from .search import Candidate, Descent, PolicySearch, SearchResult, Starts, adam
from .stopwatch import Spent, Stopwatch

__all__ = [
    "OUTERMOST",
    "PLAIN",
    "TALL",
    "Candidate",
    "Descent",
    "MaskBatch",
    "ModelBatch",
    "Particles",
    "PolicyBatch",
    "PolicySearch",
    "Problem",
    "RolloutFunction",
    "SearchResult",
    "Spent",
    "Starts",
    "Stopwatch",
    "adam",
    "batched",
    "follow",
    "fused",
    "multiply",
    "multiply_lower",
    "multiply_upper",
    "pack",
    "rollout",
    "rollout_batch",
    "rollout_of",
    "set_exponentials",
    "strip",
    "warn_without_numba",
]
