"""Recordings with fewer samples, driven as before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.recordings import Recording, reduced


def recorded(rows: int = 41, every: int = 2) -> Recording:
    rng = np.random.default_rng(0)
    held = rng.standard_normal((rows * every, 1))
    return Recording(
        name="log",
        time=0.0025 * np.arange(rows),
        states=rng.standard_normal((rows, 2)),
        inputs=held.reshape(rows, every, 1).mean(axis=1),
        state_names=("x", "x_velocity"),
        input_names=("u",),
        gaps=((0.0175, 0.0525),),
        held=held,
        by_clock=held + 1.0,
    )


def test_fewer_samples_keep_all_inputs() -> None:
    whole = recorded()
    thin = whole.every_nth(4)
    assert thin.dt == pytest.approx(0.01)
    assert thin.every == 8
    np.testing.assert_array_equal(thin.states, whole.states[:40:4])
    np.testing.assert_array_equal(thin.driven(8), whole.driven(2)[:80])
    np.testing.assert_allclose(thin.clocked.inputs, thin.inputs + 1.0)


def test_a_gap_grows_to_the_next_samples() -> None:
    assert recorded().every_nth(4).gaps == (pytest.approx((0.01, 0.06)),)


def ten_seconds(name: str, samples: int = 200) -> Recording:
    """A pendulum that is read every twentieth of a second, driven twice as often."""
    held = np.arange(2.0 * samples)[:, None]
    return Recording(
        name=name,
        time=0.05 * np.arange(samples),
        states=np.stack([np.arange(samples), np.zeros(samples)], axis=1),
        inputs=held.reshape(samples, 2, 1).mean(axis=1),
        state_names=("angle", "velocity"),
        input_names=("torque",),
        gaps=((0.2, 0.4), (1.0, 2.0)),
        held=held,
    )


def test_each_part_lacks_something_and_keeps_what_is_held_out() -> None:
    names = ["one", "two", "three"]
    found = dict(reduced([ten_seconds(name) for name in names], ["three"], 0.5))
    assert list(found) == ["one", "two", "every second sample", "the first 0.5 s"]
    assert [each.name for each in found["one"]] == ["two", "three"]
    assert [len(each) for each in found["every second sample"]] == [100] * 3
    assert [len(each) for each in found["the first 0.5 s"]] == [190] * 3
    assert len(dict(reduced([ten_seconds("alone")], [], 0.5))) == 2


def test_what_begins_later_has_its_own_samples_inputs_and_gaps() -> None:
    whole = ten_seconds("one")
    later = whole.from_sample(10)
    np.testing.assert_array_equal(later.states, whole.states[10:])
    np.testing.assert_array_equal(later.driven(2), whole.driven(2)[20:])
    np.testing.assert_allclose(later.gaps, [(0.5, 1.5)])
    assert later.time[0] == 0.0
    assert later.every == whole.every


def test_positions_are_taken_earlier_once() -> None:
    moving = replace(ten_seconds("one"), velocities=((0, 1),))
    moving.states[:, 1] = 20.0
    early = moving.earlier(0.002).every_nth(2)
    np.testing.assert_allclose(early.states[:, 0], moving.states[::2, 0] - 0.04)
    assert early.earlier(0.002) is early
    np.testing.assert_allclose(early.earlier(0.0).states, moving.states[::2], atol=1e-12)


def test_samples_that_are_too_close_are_thinned() -> None:
    whole = recorded()
    assert whole.thinned(0.01).dt == pytest.approx(0.01)
    assert whole.thinned(0.003) is whole
