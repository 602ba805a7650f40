"""Laws of the excitation: bounded, seeded, and rich in what the effects need."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mcpilco.recordings import PARTS, excitation, repeated_part
from mcpilco.recordings.excitations import pulses
from mcpilco.typing import InputError

DT = 0.02
LOW, HIGH = np.array([-10.0]), np.array([10.0])


def force(steps: int = 3000, seed: int = 0, dt: float = DT) -> np.ndarray:
    return excitation(LOW, HIGH, steps, dt, np.random.default_rng(seed))[:, 0]


@settings(max_examples=40, deadline=None)
@given(
    low=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=3),
    width=st.floats(1e-3, 1e3),
    steps=st.integers(1, 300),
    dt=st.floats(1e-3, 1.0),
    seed=st.integers(0, 100),
)
def test_inputs_keep_their_bounds(low: list, width: float, steps: int, dt: float, seed: int):
    smallest = np.array(low)
    rng = np.random.default_rng(seed)
    inputs = excitation(smallest, smallest + width, steps, dt, rng)
    assert inputs.shape == (steps, len(low))
    assert (inputs >= smallest - 1e-9).all()
    assert (inputs <= smallest + width + 1e-9).all()


def test_equal_seeds_give_equal_inputs_and_others_differ() -> None:
    np.testing.assert_array_equal(force(seed=3), force(seed=3))
    assert not np.array_equal(force(seed=3), force(seed=4))


@pytest.mark.parametrize("part", PARTS.values())
@pytest.mark.parametrize("dt", [0.002, 0.02, 0.1])
def test_every_part_is_within_the_unit_range_and_has_no_drift(part, dt: float) -> None:
    time = dt * np.arange(max(4, round(2 / dt)))
    for seed in range(5):
        wave = part(time, np.random.default_rng(seed))
        assert np.abs(wave).max() <= 1 + 1e-12
        assert np.abs(wave).max() > 0
        assert abs(wave.mean()) < 0.2


def test_a_kind_is_repeated_up_to_the_largest_value_of_each_input() -> None:
    inputs = repeated_part(pulses, np.array([2.0, 0.5]), 6.0, 3, DT)
    assert inputs.shape == (round(6.0 / DT), 2)
    np.testing.assert_allclose(np.abs(inputs).max(axis=0), [2.0, 0.5])
    thirds = np.abs(inputs[:, 0]).reshape(3, -1).max(axis=1)
    np.testing.assert_allclose(thirds, 2.0)


def test_pulses_leave_a_free_joint_where_it_was() -> None:
    wave = pulses(DT * np.arange(120), np.random.default_rng(0))
    speed = np.cumsum(wave)
    assert abs(speed[-1]) < 1e-9
    assert abs(np.sum(speed - wave / 2)) < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_a_minute_holds_what_each_effect_needs(seed: int) -> None:
    u = force(seed=seed)
    power = np.abs(np.fft.rfft(u)) ** 2
    frequency = np.fft.rfftfreq(len(u), DT)
    bands = [power[(frequency >= a) & (frequency < b)].sum() / power.sum() for a, b in BANDS]
    assert min(bands) > 0.01
    assert np.abs(u).max() == pytest.approx(10, rel=0.01)
    small = (np.abs(u) > 0) & (np.abs(u) < 1.0)
    assert small.mean() > 0.05
    assert (u == 0).mean() > 0.05
    assert abs(u.mean()) < 0.5


BANDS = [(0.1, 0.5), (0.5, 1.5), (1.5, 4), (4, 10)]
"""[Hz]: slow friction, the swing, the upper swing, delay and lag"""


def test_two_inputs_do_not_move_together() -> None:
    rng = np.random.default_rng(0)
    u = excitation(np.repeat(LOW, 2), np.repeat(HIGH, 2), 3000, DT, rng)
    assert abs(np.corrcoef(u.T)[0, 1]) < 0.3


def test_a_one_sided_input_rests_at_its_edge() -> None:
    rng = np.random.default_rng(0)
    u = excitation(np.zeros(1), np.ones(1), 3000, DT, rng)
    assert (u == 0).any()


@pytest.mark.parametrize(
    ("low", "high", "steps", "dt", "said"),
    [
        (-np.inf, 1.0, 10, 0.1, "finite bounds low < high"),
        (1.0, 1.0, 10, 0.1, "finite bounds low < high"),
        (-1.0, 1.0, 0, 0.1, "steps >= 1"),
        (-1.0, 1.0, 10, 0.0, "dt > 0 s"),
    ],
)
def test_what_cannot_be_excited_is_refused(low, high, steps, dt, said: str) -> None:
    with pytest.raises(InputError, match=said):
        excitation(np.array([low]), np.array([high]), steps, dt, np.random.default_rng(0))
