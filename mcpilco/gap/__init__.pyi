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
    HIDDEN,
    IN_SAMPLE,
    Gap,
    closed_share,
    doubt_lines,
    left_out_lines,
    percent,
    runaway_lines,
    shift_lines,
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
    "HIDDEN",
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
    "closed_share",
    "cut",
    "doubt_lines",
    "fit_initial_states",
    "fit_model",
    "investigate",
    "left_out_lines",
    "percent",
    "repetitions",
    "residuals_at",
    "run",
    "runaway_lines",
    "scaled_errors",
    "shift_lines",
    "squares_at_end",
    "summary",
    "three_digits",
    "to_json",
    "truncated",
    "usual_scales",
    "verdict_sentence",
    "write_json",
]
