"""Laws of the filters: what is slow stays, nothing is delayed, noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.recordings import encoder_noise, local_cubics, motion_cutoff, zero_phase
from mcpilco.typing import InputError

DT = 0.002
TIME = DT * np.arange(5000)
W = 2.0 * np.pi * np.array([0.6, 1.3])
NONE = np.full((len(TIME), 2), np.nan)


def sinusoids():
    """q, q' and q'' of two joints."""
    angle = W * TIME[:, None]
    return np.sin(angle), W * np.cos(angle), -(W**2) * np.sin(angle)


@pytest.mark.parametrize("name", ["zero-phase", "local cubics"])
@pytest.mark.parametrize("velocities", [False, True])
def test_a_slow_motion_and_its_derivatives_stay(name, velocities):
    q, dq, ddq = sinusoids()
    measured = dq if velocities else NONE
    if name == "zero-phase":
        found = zero_phase(q, measured, ddq, DT, cutoff=8.0)
        ends, step = round(3.0 / 8.0 / DT), 7
    else:
        found, ends, step = local_cubics(q, measured, ddq, DT), 15, 1
    rows = slice(ends, -ends, step)
    for one, other in ((found.q, q), (found.dq, dq), (found.ddq, ddq), (found.tau, ddq)):
        assert len(one) == len(other[rows])
        np.testing.assert_allclose(one, other[rows], atol=5e-3 * np.abs(other).max())


def test_the_noise_of_encoders_is_found():
    noise = np.array([1e-3, 2e-4])
    q = sinusoids()[0] + noise * np.random.default_rng(0).normal(size=(len(TIME), 2))
    np.testing.assert_allclose(encoder_noise(q, DT), noise, rtol=0.05)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_the_cutoff_is_above_the_motion_whatever_the_noise(noise):
    q = sinusoids()[0] + noise * np.random.default_rng(0).normal(size=(len(TIME), 2))
    assert 2.0 * 1.3 < motion_cutoff(q, DT) < 8.0 * 1.3


def test_dry_friction_is_filtered_as_the_forces_are():
    q, dq, _ = sinusoids()
    friction = np.array([0.3, 2.0])
    found = zero_phase(q, NONE, friction * np.sign(dq), DT, cutoff=5.0)
    for j in range(2):
        (fitted,) = np.linalg.lstsq(found.dry[:, j : j + 1], found.tau[:, j], rcond=None)[0]
        (naive,) = np.linalg.lstsq(np.sign(found.dq[:, j : j + 1]), found.tau[:, j], rcond=None)[0]
        assert fitted == pytest.approx(friction[j], rel=0.01)
        assert naive < 0.97 * friction[j]


def test_less_than_the_filter_needs_is_refused():
    q = sinusoids()[0][:100]
    with pytest.raises(InputError, match="without a gap were expected, got 0.2 s"):
        zero_phase(q, NONE[:100], q, DT, cutoff=5.0)
    with pytest.raises(InputError, match="half of the sampling rate, got 300"):
        zero_phase(q, NONE[:100], q, DT, cutoff=300.0)
