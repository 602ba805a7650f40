from .brake import BALANCED, Brake, careful
from .costs import QuadraticCost, SaturatingCost, TipCost, cart_pole_cost, held
from .policies import (
    BASES_PER_HASH,
    GOLDEN,
    Bounds,
    Dropout,
    Squash,
    SumOfGaussians,
    blank_policy,
    random_policy,
)
from .regulator import Regulator, riccati
from .reward_cost import RewardCost, costs_of, with_cost
from .stage import Stage, program_of

__all__ = [
    "BALANCED",
    "BASES_PER_HASH",
    "GOLDEN",
    "Bounds",
    "Brake",
    "Dropout",
    "QuadraticCost",
    "Regulator",
    "RewardCost",
    "SaturatingCost",
    "Squash",
    "Stage",
    "SumOfGaussians",
    "TipCost",
    "blank_policy",
    "careful",
    "cart_pole_cost",
    "costs_of",
    "held",
    "program_of",
    "random_policy",
    "riccati",
    "with_cost",
]
