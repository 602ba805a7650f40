from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

import envs
from mcpilco.gap.fit import Fit
from mcpilco.gap.model import Model
from mcpilco.gap.validate import OF_EACH_SIZE, fewest, promising
from mcpilco.plant import CATALOGUE, EffectInstance

WINDOWS = 40
EFFECTS = np.array([0, 1, 2])


def missed(first: float, second: float, spread: float) -> Float[np.ndarray, "3 W"]:
    """Log misfits of models of none, one and two effects; `second` is sure to within `spread`."""
    one, two = 3.0 - first, 3.0 - first - second
    scatter = spread * np.resize([1.0, -1.0], WINDOWS)
    return np.stack([np.full(WINDOWS, 3.0), np.full(WINDOWS, one), two + scatter])


@pytest.mark.parametrize(("second", "effects"), [(1.0, 2), (0.2, 1), (-0.2, 1)])
def test_an_effect_is_taken_where_it_predicts_surely_better(second: float, effects: int) -> None:
    assert fewest(missed(1.0, second, 2.0), EFFECTS, EFFECTS, 1.0) == effects


def test_an_effect_that_gains_next_to_nothing_is_not_taken_however_sure() -> None:
    assert fewest(missed(1.0, 0.05, 1e-3), EFFECTS, EFFECTS, 1.0) == 1


def test_windows_that_overlap_count_once() -> None:
    found = missed(0.0, 1.0, 2.0)
    assert fewest(found, EFFECTS, EFFECTS, 1.0) == 2
    assert fewest(found, EFFECTS, EFFECTS, 20.0) == 0


def test_of_as_many_effects_that_with_the_fewest_numbers_is_taken() -> None:
    found = missed(1.0, 0.2, 2.0)[1:]
    assert fewest(found, np.array([1, 1]), np.array([2, 1]), 1.0) == 1
    assert fewest(found, np.array([1, 1]), np.array([1, 2]), 1.0) == 0


def test_fewer_numbers_come_before_fewer_effects() -> None:
    """Two Coulomb frictions and an offset before two frictions that differ by direction."""
    found = missed(1.0, 0.2, 2.0)[1:]
    assert fewest(found, np.array([2, 3]), np.array([4, 3]), 1.0) == 1


def fit_of(*names: str, chi2: float) -> Fit:
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    named = tuple(EffectInstance(CATALOGUE[name], "pendulum") for name in names)
    return Fit(Model(plant, named, {}, {}), np.empty(0), np.empty((0, 2)), chi2, np.empty(0))


def test_special_cases_of_promising_models_are_promising_and_bad_ones_are_not() -> None:
    general = "spring", "hardening_spring", "position_ripple", "viscous_friction", "quadratic_drag"
    pairs = [fit_of("asymmetric_friction", other, chi2=1.0) for other in general[:OF_EACH_SIZE]]
    plain = fit_of("coulomb_friction", "spring", chi2=2.0)
    other = fit_of("stribeck_friction", "spring", chi2=1.5)
    bad = fit_of("coulomb_friction", "quadratic_drag", chi2=4.0)
    single = fit_of("spring", chi2=2.9)
    kept = promising([*pairs, other, plain, single, bad])
    assert [known for known in (plain, single, other, bad) if any(known is k for k in kept)] == [
        plain,
        single,
    ]
