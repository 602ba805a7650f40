"""Laws of one episode: the record is what happened, and what an env must not do is noticed."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.agent.episode import BrokenEpisodeError, reported, run_episode
from mcpilco.data import Rollout
from mcpilco.typing import EnvError
from tests.mcpilco.point import DT, PointEnv


def run(env: PointEnv, force: float = 0.5, horizon: int = 6, **kwargs) -> Rollout:
    return run_episode(env, lambda _: np.array([force]), horizon, DT, **kwargs)


def test_the_record_has_a_row_for_each_step_and_the_start() -> None:
    rollout = run(PointEnv(), seed=0)
    assert rollout.observations.shape == rollout.states.shape == (7, 2)
    assert rollout.inputs.shape == (6, 1)
    assert rollout.rewards.shape == (6,)
    assert rollout.dt == DT
    assert rollout.outcome == {"is_success": 0.0}


def test_the_record_obeys_the_envs_equations() -> None:
    rollout = run(PointEnv(), seed=0)
    position, velocity = rollout.states.T
    np.testing.assert_allclose(np.diff(velocity), DT * rollout.inputs[:, 0], atol=1e-15)
    mean_velocity = (velocity[1:] + velocity[:-1]) / 2
    np.testing.assert_allclose(np.diff(position), DT * mean_velocity, atol=1e-15)
    noise = rollout.observations - rollout.states
    assert (noise[:, 0] != 0).all()
    assert np.abs(noise).max() < 0.06


def test_the_policy_sees_the_observations() -> None:
    seen = []

    def act(observation: np.ndarray) -> np.ndarray:
        seen.append(observation)
        return np.zeros(1)

    rollout = run_episode(PointEnv(), act, 4, DT, seed=0)
    np.testing.assert_array_equal(seen, rollout.observations[:-1])


@pytest.mark.parametrize(("wanted", "given"), [(5.0, 2.0), (-np.inf, -2.0), (0.25, 0.25)])
def test_inputs_are_clipped_and_recorded_as_given(wanted: float, given: float) -> None:
    env = PointEnv(limit=2.0)
    rollout = run(env, wanted)
    np.testing.assert_array_equal(rollout.inputs, np.full((6, 1), given))
    assert all(env.action_space.contains(action) for action in env.actions)


def test_inputs_are_recorded_as_rounded_to_the_action_space() -> None:
    rollout = run(PointEnv(dtype=np.float32), 0.1)
    assert rollout.inputs.dtype == np.float64
    np.testing.assert_array_equal(rollout.inputs, np.full((6, 1), np.float64(np.float32(0.1))))


@pytest.mark.parametrize("last", [1, 4])
def test_a_terminated_episode_is_as_long_as_it_was(last: int) -> None:
    rollout = run(PointEnv(ends_at=last))
    assert len(rollout) == last
    assert len(rollout.observations) == last + 1


def test_equal_seeds_give_equal_records_and_others_differ() -> None:
    first, again, other = (run(PointEnv(), seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.observations, again.observations)
    assert (first.observations != other.observations).all(0)[0]


@pytest.mark.parametrize(
    ("bad", "shown"),
    [
        (np.array([0.0, np.nan]), "nan"),
        (np.array([np.inf, 0.0]), "inf"),
        (np.zeros(3), r"array\(\[0., 0., 0.\]\)"),
        ({"position": 0.0}, "position"),
        (None, "None"),
    ],
)
def test_a_wrong_observation_is_answered_with_a_sentence(bad, shown: str) -> None:
    with pytest.raises(EnvError, match=rf"shape \(2,\), got observation .*{shown}.* at step 3"):
        run(PointEnv(bad=bad, bad_at=3))


def test_a_wrong_reward_is_answered_with_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    step = PointEnv.step
    monkeypatch.setattr(
        PointEnv, "step", lambda self, action: (step(self, action)[0], np.nan, False, False, {})
    )
    with pytest.raises(EnvError, match="reward .*nan.* at step 1"):
        run(PointEnv())


@pytest.mark.parametrize("state", [None, np.zeros(5), "hidden"])
def test_a_state_that_is_not_like_an_observation_is_left_out(
    monkeypatch: pytest.MonkeyPatch, state
) -> None:
    step = PointEnv.step
    monkeypatch.setattr(
        PointEnv, "step", lambda self, action: (*step(self, action)[:4], {"state": state})
    )
    rollout = run(PointEnv())
    assert rollout.states is None
    assert rollout.outcome == {}


def test_a_true_state_that_is_not_finite_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    step = PointEnv.step
    bad = {"state": np.array([0.0, np.nan])}
    monkeypatch.setattr(PointEnv, "step", lambda self, action: (*step(self, action)[:4], bad))
    with pytest.raises(EnvError, match=r'info\["state"\] .*nan.* at step 1'):
        run(PointEnv())


def test_what_breaks_off_tells_the_steps_before() -> None:
    whole = run(PointEnv(), seed=0)
    with pytest.raises(BrokenEpisodeError) as broken:
        run(PointEnv(bad=None, bad_at=4), seed=0)
    rollout = broken.value.rollout
    np.testing.assert_array_equal(rollout.observations, whole.observations[:4])
    np.testing.assert_array_equal(rollout.states, whole.states[:4])
    np.testing.assert_array_equal(rollout.inputs, whole.inputs[:3])
    np.testing.assert_array_equal(rollout.rewards, whole.rewards[:3])
    assert rollout.outcome == {"is_success": 0.0}


@pytest.mark.parametrize("method", ["reset", "step"])
def test_what_the_env_raises_is_named(monkeypatch: pytest.MonkeyPatch, method: str) -> None:
    def broken(*_, **__):
        raise ConnectionError("no robot")

    monkeypatch.setattr(PointEnv, method, broken)
    with pytest.raises(EnvError, match=r"raised ConnectionError at step \d: no robot; mend"):
        run(PointEnv())


def test_an_error_of_the_policy_is_not_blamed_on_the_env() -> None:
    with pytest.raises(ZeroDivisionError):
        run_episode(PointEnv(), lambda _: 1 / 0, 3, DT)


def test_numbers_named_with_their_unit_are_reported_and_all_else_is_not():
    info = {"is_success": True, "reach_m": np.float32(0.5), "reward": 1.0, "path_m": np.zeros(3)}
    assert reported(info) == {"is_success": 1.0, "reach_m": 0.5}
    batch = {"reach_m": np.array([1.0, 2.0]), "_reach_m": np.array([True, True])}
    assert {name: list(value) for name, value in reported(batch, (2,)).items()} == {
        "reach_m": [1.0, 2.0]
    }
