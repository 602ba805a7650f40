from __future__ import annotations

import numpy as np
import pytest
from jaxtyping import Float

from mcpilco.gap.validate import fewest

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
