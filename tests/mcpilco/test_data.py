"""Laws of measured data: rows stay together, and nothing that is not finite comes in."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest

from mcpilco.data import Rollout, Transitions, html_table, is_measure, title_of
from mcpilco.typing import InputError


def some_rows(count: int, seed: int = 0) -> Transitions:
    rng = np.random.default_rng(seed)
    return Transitions(
        rng.normal(size=(count, 3)), rng.normal(size=(count, 2)), rng.normal(size=(count, 3))
    )


def test_a_sum_holds_the_rows_of_both_in_order() -> None:
    first, second = some_rows(4, 1), some_rows(2, 2)
    both = first + second
    assert len(both) == 6
    for part, rows in ((first, slice(4)), (second, slice(4, 6))):
        for name, array in vars(part).items():
            np.testing.assert_array_equal(getattr(both[rows], name), array)


def test_an_index_keeps_rows_together() -> None:
    rows = some_rows(5)
    chosen = rows[np.array([3, 1])]
    for name, array in vars(rows).items():
        np.testing.assert_array_equal(getattr(chosen, name), array[[3, 1]])


@pytest.mark.parametrize("name", ["states", "inputs", "next_states"])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_row_that_is_not_finite_is_named(name: str, bad: float) -> None:
    arrays = {key: array.copy() for key, array in vars(some_rows(4)).items()}
    arrays[name][2, 1] = bad
    with pytest.raises(InputError, match=rf"Transitions.{name} .* at index \[2, 1\]"):
        Transitions(**arrays)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("states", "inputs", "next_states"),
    [
        ((4, 3), (3, 2), (4, 3)),
        ((4, 3), (4, 2), (4, 2)),
        ((4, 3), (4, 2), (5, 3)),
        ((4,), (4, 2), (4,)),
        ((4, 3), (4,), (4, 3)),
    ],
)
def test_arrays_that_are_no_rows_are_refused(states, inputs, next_states) -> None:
    with pytest.raises(InputError, match="as many rows"):
        Transitions(np.zeros(states), np.zeros(inputs), np.zeros(next_states))


def test_transitions_of_a_rollout_are_what_the_agent_saw() -> None:
    rng = np.random.default_rng(0)
    seen, true, inputs = rng.normal(size=(6, 2)), rng.normal(size=(6, 2)), rng.normal(size=(5, 1))
    rollout = Rollout(dt=0.1, observations=seen, inputs=inputs, rewards=np.zeros(5), states=true)
    rows = rollout.transitions()
    np.testing.assert_array_equal(rows.states, seen[:5])
    np.testing.assert_array_equal(rows.next_states, seen[1:])
    np.testing.assert_array_equal(rows.inputs, inputs)
    np.testing.assert_array_equal(rollout.shown_states, true)
    np.testing.assert_allclose(rollout.times, [0.0, 0.1, 0.2, 0.3, 0.4, 0.5], rtol=1e-15)
    assert len(rollout) == 5


def test_without_true_states_the_observations_are_shown() -> None:
    seen = np.ones((3, 2))
    rollout = Rollout(dt=0.1, observations=seen, inputs=np.zeros((2, 1)), rewards=np.zeros(2))
    assert rollout.shown_states is seen


@pytest.mark.parametrize(
    ("name", "title"),
    [
        ("time_up_s", "time up [s]"),
        ("tip_speed_m_per_s", "tip speed [m/s]"),
        ("work_J", "work [J]"),
    ],
)
def test_a_measure_is_named_with_its_unit(name, title):
    assert is_measure(name)
    assert title_of(name) == title


@pytest.mark.parametrize(
    "name", ["score", "_time_up_s", "wall_s", "experience_s", "_s", "is_success"]
)
def test_what_has_no_unit_or_is_no_envs_is_no_measure(name):
    assert not is_measure(name)


def test_a_table_in_html_has_the_columns_of_all_rows_and_escapes_what_they_hold() -> None:
    table = ElementTree.fromstring(html_table([{"a": "1", "b": "<i>&"}, {"a": "2", "c [m]": "3"}]))
    lines = [[cell.text for cell in line] for line in table.iter("tr")]
    assert lines == [["a", "b", "c [m]"], ["1", "<i>&", "-"], ["2", "-", "3"]]


def test_a_mirror_turns_every_sign_and_twice_turns_none() -> None:
    rows = some_rows(3)
    image = rows.mirrored()
    for name, values in vars(rows).items():
        np.testing.assert_array_equal(getattr(image, name), -values)
        np.testing.assert_array_equal(getattr(image.mirrored(), name), values)
