from .bayesian import NoisyInputConfig, NoisyInputFit, fit_noisy_inputs, middle_reliability
from .methods import METHODS
from .regression import (
    Moments,
    Solution,
    UnidentifiedWarning,
    errors_in_variables,
    instrumental_variables,
    noise_above,
    noise_of_repetitions,
    refine,
)

__all__ = [
    "METHODS",
    "Moments",
    "NoisyInputConfig",
    "NoisyInputFit",
    "Solution",
    "UnidentifiedWarning",
    "errors_in_variables",
    "fit_noisy_inputs",
    "instrumental_variables",
    "middle_reliability",
    "noise_above",
    "noise_of_repetitions",
    "refine",
]
