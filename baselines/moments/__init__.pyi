from .costs import expected_cost
from .image import (
    Bases,
    Gaussian,
    Image,
    gaussian_through_gp,
    gaussian_through_squash,
    gaussian_through_trig,
    through_bases,
    through_sine,
    through_squash,
    through_trig,
    through_waves,
)

__all__ = [
    "Bases",
    "Gaussian",
    "Image",
    "expected_cost",
    "gaussian_through_gp",
    "gaussian_through_squash",
    "gaussian_through_trig",
    "through_bases",
    "through_sine",
    "through_squash",
    "through_trig",
    "through_waves",
]
