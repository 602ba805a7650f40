from .comparison import (
    ComparedModels,
    Comparison,
    MissingForce,
    TimeMap,
    missing_force,
    scaled_errors,
    squares_at_end,
    time_map,
)
from .data import Event, GapProblem, Windows, usual_scales
from .decide import Closest, EstimatedParameter, NamedEffect
from .disagreement import Disagreement
from .fit import Fit, fit_initial_states, fit_model, truncated
from .investigation import investigate
from .report import (
    IN_SAMPLE,
    Gap,
    cautions,
    closed_share,
    percent,
    summary,
    three_digits,
    to_json,
    verdict_sentence,
    write_json,
)
from .search import SearchResult
from .stability import Stability, repetitions
from .thresholds import COMPARISON, DATA

__all__ = [
    "COMPARISON",
    "DATA",
    "IN_SAMPLE",
    "Closest",
    "ComparedModels",
    "Comparison",
    "Disagreement",
    "EstimatedParameter",
    "Event",
    "Fit",
    "Gap",
    "GapProblem",
    "MissingForce",
    "NamedEffect",
    "SearchResult",
    "Stability",
    "TimeMap",
    "Windows",
    "cautions",
    "closed_share",
    "fit_initial_states",
    "fit_model",
    "investigate",
    "missing_force",
    "percent",
    "repetitions",
    "scaled_errors",
    "squares_at_end",
    "summary",
    "three_digits",
    "time_map",
    "to_json",
    "truncated",
    "usual_scales",
    "verdict_sentence",
    "write_json",
]
