"""What an agent makes of measurements: in the loop as in the rollouts, and after an episode."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent import MCPILCO, run_episode
from mcpilco.config import PRESETS, Config, EstimatorConfig, PolicyConfig, SearchConfig
from mcpilco.search import rollout
from mcpilco.sensing.perception import state_of, state_view, unwrapped
from mcpilco.sweep import FreshEpisodes
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError, RunFolderError
from tests.mcpilco.swinging import CIRCLE, DT, TASK, Swinging

POSITIONS = "mcpilco/CartPoleSwingUpPositions-v0"
STEPS = 12


def hasty(**estimator) -> Config:
    """Learns nothing, in no time."""
    search = SearchConfig(particles=8, steps=(3,), restarts=(0,), evaluation_particles=8)
    return dataclasses.replace(
        PRESETS["default"].config,
        policy=PolicyConfig(bases=10),
        search=search,
        estimator=EstimatorConfig(**estimator),
        horizon=STEPS,
        engine="eager",
    )


def learned(trials: int = 1, env: gym.Env | str = POSITIONS, **estimator) -> MCPILCO:
    agent = MCPILCO("SumOfGaussians", env, config=hasty(**estimator), seed=3)
    return agent.learn((trials + 1) * STEPS)


@pytest.fixture(scope="module")
def agent() -> MCPILCO:
    return learned(trials=2)


def test_the_policy_acts_on_what_the_rollouts_estimate_to_the_last_digit(agent: MCPILCO) -> None:
    """The recorded measurements, fed to the observer of the particles, give the inputs applied."""
    record = agent.results[-1].rollout
    observer = agent.perception.adapted(agent.transitions[: -len(record)]).observer()
    memory = observer.estimator.begin(torch.from_numpy(record.observations[:1]))
    for t, applied in enumerate(record.inputs):
        estimate, memory = observer.estimator.observe(
            torch.from_numpy(record.observations[t : t + 1]), memory
        )
        np.testing.assert_array_equal(estimate[0].numpy(), record.estimates[t])
        with torch.no_grad():
            wanted = np.clip(agent.policy(estimate).numpy(), agent.low, agent.high)
        np.testing.assert_array_equal(wanted[0].astype(np.float32), applied.astype(np.float32))


def test_the_model_learns_from_smoothed_states(agent: MCPILCO) -> None:
    record = agent.results[-1].rollout
    assert record.observations.shape == (STEPS + 1, 2)
    assert record.states.shape == record.smoothed.shape == (STEPS + 1, 4)
    np.testing.assert_array_equal(agent.transitions.states[-STEPS:], record.smoothed[:-1])
    np.testing.assert_allclose(record.smoothed[:, [0, 2]], record.observations, atol=0.1)


def test_predict_remembers_through_its_state_and_forgets_at_an_episodes_start(
    agent: MCPILCO,
) -> None:
    series = np.random.default_rng(0).normal(size=(6, 3, 2))
    state, batch = None, []
    for t, now in enumerate(series):
        starts = np.array([t == 0, t == 3, False])
        action, state = agent.predict(now, state=state, episode_start=starts)
        batch.append(action)
    for column, begins in enumerate((0, 3, 0)):
        act = agent.controller()
        alone = [act(now[column]) for now in series[begins:]]
        np.testing.assert_array_equal(np.array(batch)[begins:, column], np.array(alone))
    fresh, _ = agent.predict(series[-1])
    assert not np.array_equal(fresh, batch[-1])


def test_stable_baselines_evaluates_it_as_a_recurrent_policy(agent: MCPILCO) -> None:
    env = Monitor(gym.make(POSITIONS, max_episode_steps=STEPS))
    env.reset(seed=5)
    mean, _ = evaluate_policy(agent, env, n_eval_episodes=2)
    env = gym.make(POSITIONS, max_episode_steps=STEPS)
    env.reset(seed=5)
    returns = []
    for _ in range(2):
        observation, _ = env.reset()
        act, total, over = agent.controller(), 0.0, False
        while not over:
            observation, reward, _, over, _ = env.step(act(observation))
            total += reward
        returns.append(total)
    assert mean == pytest.approx(np.mean(returns), abs=1e-6)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_state_of_other_observations_is_refused(agent: MCPILCO) -> None:
    _, state = agent.predict(np.zeros((3, 2)))
    with pytest.raises(InputError, match="pass None to begin an episode"):
        agent.predict(np.zeros((2, 2)), state=state)
    with pytest.raises(InputError, match="finite observations of 2 numbers .'cart_position'"):
        agent.predict(np.zeros(4))


def test_a_loaded_agent_estimates_and_learns_on_as_the_saved_one(agent: MCPILCO, tmp_path) -> None:
    path = agent.save(tmp_path / "agent.npz")
    loaded = MCPILCO.load(path, POSITIONS)
    acts = agent.controller(), loaded.controller(), MCPILCO.load(path).controller()
    for now in np.random.default_rng(1).normal(size=(5, 2)):
        first, *others = (act(now) for act in acts)
        assert all(np.array_equal(first, other) for other in others)
    assert np.isfinite(loaded.learn(STEPS).results[-1].real_cost)
    with pytest.raises((RunFolderError, EnvError)):
        MCPILCO.load(path, "mcpilco/CartPoleSwingUp-v0")


def test_a_damaged_estimator_is_refused(agent: MCPILCO) -> None:
    arrays = agent.perception.to_arrays()
    wrong = {"gains": arrays["gains"][:, :, :1], "A": arrays["A"] * np.nan, "noise_std": np.ones(3)}
    for name, array in wrong.items():
        with pytest.raises(ValueError, match="does not fit"):
            agent.perception.load_arrays({**arrays, name: array})
    with pytest.raises(ValueError, match="lacks .'gains'"):
        agent.perception.load_arrays({k: v for k, v in arrays.items() if k != "gains"})


def test_unmodelled_rollouts_see_the_states() -> None:
    for modelled in (True, False):
        agent = learned(modelled=modelled)
        problem = agent._problem(2, agent.perception)
        assert (problem.observer is not None) == modelled
        assert problem.rollout is rollout


def test_noise_that_is_not_told_is_estimated_once() -> None:
    env = gym.make(POSITIONS)
    env.unwrapped.task = dataclasses.replace(env.unwrapped.task, measurement_std=None)
    agent = learned(env=env)
    noise = agent.perception.noise_std
    assert noise.shape == (2,)
    assert (noise > 0).all()
    agent.learn(STEPS)
    assert agent.perception.noise_std is noise


def test_differences_do_not_depend_on_the_data() -> None:
    agent = learned(kind="differences", low_pass=0.25)
    np.testing.assert_array_equal(agent.perception.estimator.gains[-1, 1], [0.75 / 0.1, 0.0])


def test_fresh_episodes_each_begin_a_memory_of_their_own(agent: MCPILCO, monkeypatch) -> None:
    begun = []

    def begin():
        begun.append(agent.controller())
        return begun[-1]

    with FreshEpisodes(POSITIONS, {}, 3, STEPS) as judge:
        outcomes = judge.outcomes(begin, seed=0, trial=1)
    assert len(begun) == 1
    assert outcomes["return"].shape == (3,)
    monkeypatch.setattr("mcpilco.sweep.job._vector_form", lambda *_: None)
    with FreshEpisodes(POSITIONS, {}, 3, STEPS) as judge:
        judge.outcomes(begin, seed=0, trial=1)
    assert len(begun) == 4


# --- from observations to states ------------------------------------------------------------------

CIRCULAR = replace(TASK, **CIRCLE)


def episode(env, task: TaskSpec):
    return run_episode(state_view(env, task), lambda _: np.array([5.0]), 40, DT, seed=3)


def test_an_observation_that_is_the_state_is_taken_as_it_is() -> None:
    env = Swinging()
    assert state_view(env, TASK) is env
    observation = np.array([4.0, 1.0])
    assert state_of(TASK, observation) is observation


@pytest.mark.parametrize("angle", [-3.1, -1.0, 0.0, 2.0, 3.1])
def test_an_angle_is_found_again_from_its_cosine_and_sine(angle: float) -> None:
    observation = np.array([np.cos(angle), np.sin(angle), 7.0])
    np.testing.assert_allclose(state_of(CIRCULAR, observation), [angle, 7.0], atol=1e-12)
    batch = np.tile(observation, (4, 5, 1))
    assert state_of(CIRCULAR, batch).shape == (4, 5, 2)


def test_states_are_chosen_and_ordered_as_the_task_says() -> None:
    task = replace(TASK, angles=(), velocities=(), observed=(2, 0))
    np.testing.assert_array_equal(state_of(task, np.array([1.0, 2.0, 3.0])), [3.0, 1.0])


@pytest.mark.parametrize(("view", "observed"), [("circle", ((0, 1), 2)), ("wrapped", (0, 1))])
def test_angles_count_turns_whatever_the_env_shows_of_them(view: str, observed: tuple) -> None:
    """The pendulum, pushed into turns, looks like the one whose env tells the angle itself."""
    told = episode(Swinging(push=12.0), TASK)
    seen = episode(Swinging(view, push=12.0), replace(TASK, observed=observed))
    assert np.ptp(told.observations[:, 0]) > 2 * np.pi
    np.testing.assert_allclose(seen.observations, told.observations, atol=1e-9)


def test_unwrapping_takes_the_nearest_turn_and_leaves_what_is_no_angle() -> None:
    state = unwrapped(TASK, np.array([13.0, 0.0]), np.array([0.2, 9.0]))
    np.testing.assert_allclose(state, [0.2 + 4 * np.pi, 9.0])


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"observed": ((0, 1),)}, "say for each of the states"),
        ({"observed": ((0, 1, 2), 2)}, "pairs of them"),
        ({"observed": ((0, 1), -1)}, "must hold indices"),
        ({"observed": ((0, 1), 2.5)}, "must hold indices"),
        ({"observed": ((0, 1), 2), "angles": ()}, "TaskSpec.angles must name too"),
    ],
)
def test_what_cannot_be_observed_is_answered_with_a_sentence(entries: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(TASK, **entries)


def test_a_task_with_observed_survives_json() -> None:
    assert TaskSpec.from_json(CIRCULAR.to_json(), None) == CIRCULAR
