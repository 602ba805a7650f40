"""The rule of success, at its edges."""

from __future__ import annotations

import math

import numpy as np
import pytest

from envs.judge import UprightJudge, is_up

UP, DOWN = math.pi, 0.0


def states(angles, cart=0.0) -> np.ndarray:
    out = np.zeros((*np.shape(angles), 4))
    out[..., 2], out[..., 0] = angles, cart
    return out


def verdict(angles) -> dict:
    judge = UprightJudge(0.01, links=(2,), cart=0)
    judge.watch(states(angles))
    return judge.verdict()


@pytest.mark.parametrize("turns", [-3, -1, 0, 1, 4])
def test_up_is_within_10_degrees_of_upright_in_any_turn(turns):
    degrees = np.array([-10.01, -9.99, 0.0, 9.99, 10.01])
    angles = math.pi * (2 * turns + 1) + np.radians(degrees)
    assert is_up(angles).tolist() == [False, True, True, True, False]


def test_hanging_is_not_up_in_any_turn():
    assert not is_up(2 * math.pi * np.arange(-3, 4)).any()


@pytest.mark.parametrize(("up", "success"), [(99, False), (100, True), (101, True)])
def test_success_needs_the_last_100_samples_of_10_ms(up, success):
    assert verdict([DOWN] * 50 + [UP] * up)["is_success"] == success


def test_one_sample_down_in_the_last_second_is_no_success():
    assert not verdict([UP] * 200 + [DOWN] + [UP] * 99)["is_success"]


def test_falling_at_the_last_sample_is_no_success():
    result = verdict([UP] * 200 + [DOWN])
    assert not result["is_success"]
    assert result["time_up_s"] == pytest.approx(2.0)


def test_verdict_does_not_depend_on_how_samples_are_cut_into_steps():
    rng = np.random.default_rng(0)
    angles = np.where(rng.random(300) < 0.02, DOWN, UP)
    whole, steps = UprightJudge(0.01, links=(2,), cart=0), UprightJudge(0.01, links=(2,), cart=0)
    for step in range(30):
        part = states(angles[10 * step : 10 * step + 10])
        steps.watch(part)
        seen = angles[: 10 * step + 10]
        down = np.flatnonzero(seen == DOWN)
        unbroken = len(seen) if len(down) == 0 else len(seen) - 1 - down[-1]
        assert steps.verdict()["is_success"] == (unbroken >= 100)
    whole.watch(states(angles))
    assert whole.verdict() == steps.verdict()


def test_batch_is_judged_one_by_one_and_restarted_one_by_one():
    judge = UprightJudge(0.01, (2,), links=(2,), cart=0)
    judge.watch(states([[UP, DOWN]] * 100, cart=[-0.5, 2.0]))
    result = judge.verdict()
    assert result["is_success"].tolist() == [True, False]
    np.testing.assert_allclose(result["time_up_s"], [1.0, 0.0])
    np.testing.assert_allclose(result["mean_abs_cart_m"], [0.5, 2.0])
    judge.restart(np.array([True, False]))
    assert judge.verdict()["is_success"].tolist() == [False, False]
    np.testing.assert_allclose(judge.verdict()["mean_abs_cart_m"], [0.0, 2.0])


def test_sampling_time_that_does_not_divide_1_s_needs_a_little_longer():
    judge = UprightJudge(0.03, links=(2,))
    judge.watch(states([UP] * 33))
    assert not judge.verdict()["is_success"]
    judge.watch(states([UP]))
    assert judge.verdict()["is_success"]


def test_system_without_a_cart_is_judged_by_its_angle_alone():
    judge = UprightJudge(0.01, links=(0,))
    judge.watch(np.full((100, 2), UP))
    assert judge.verdict() == {"is_success": True, "time_up_s": pytest.approx(1.0)}
