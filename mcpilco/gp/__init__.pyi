from .evidence import JITTERS, add_to_diagonal, cholesky
from .gp import GP, RECENT, FitReport, Further, Posterior, Samples
from .weight_space import WeightPosterior, WeightSpaceGP, subset_of_data

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
    "subset_of_data",
]
