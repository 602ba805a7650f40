from .comparison import (
    ComparedModels,
    Comparison,
    scaled_errors,
    squares_at_end,
)
from .data import Event, GapProblem, Windows, cut, usual_scales
from .decide import Closest, EstimatedParameter, NamedEffect
from .disagreement import Disagreement
from .fit import Fit, fit_initial_states, fit_model, truncated
from .investigation import investigate
from .plant_model import PlantModel
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
from .sensitivities import residuals_at, run
from .stability import Stability, repetitions
from .thresholds import DATA

__all__ = [
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
    "NamedEffect",
    "PlantModel",
    "SearchResult",
    "Stability",
    "Windows",
    "cautions",
    "closed_share",
    "cut",
    "fit_initial_states",
    "fit_model",
    "investigate",
    "percent",
    "repetitions",
    "residuals_at",
    "run",
    "scaled_errors",
    "squares_at_end",
    "summary",
    "three_digits",
    "to_json",
    "truncated",
    "usual_scales",
    "verdict_sentence",
    "write_json",
]
