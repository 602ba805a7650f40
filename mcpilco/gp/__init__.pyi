from .evidence import JITTERS, add_to_diagonal, cholesky
from .gp import GP, RECENT, FitReport, Further, Posterior, Samples
from .sparse import condition_through, evenly_spaced, inducing_points, subset_of_data
from .weight_space import WeightPosterior, WeightSpaceGP

__all__ = [
    "GP",
    "JITTERS",
    "RECENT",
    "FitReport",
    "Further",
    "Posterior",
    "Samples",
    "WeightPosterior",
    "WeightSpaceGP",
    "add_to_diagonal",
    "cholesky",
    "condition_through",
    "evenly_spaced",
    "inducing_points",
    "subset_of_data",
]
