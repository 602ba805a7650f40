"""A recording with fewer samples, driven as before."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings import Recording


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
