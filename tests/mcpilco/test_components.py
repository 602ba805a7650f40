"""An agent with any component of the model learns, acts, and comes back from its file the same."""

from __future__ import annotations

import dataclasses

import gymnasium
import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent import MCPILCO
from mcpilco.config import Config, ModelConfig
from mcpilco.data import Transitions
from mcpilco.files import read_groups, write_groups
from mcpilco.logbook import RunFolder, read_transitions
from mcpilco.search import rollout
from mcpilco.sensing import Chain, DelayModel, LinearEstimator, StateTracker
from mcpilco.show.recorder import Recorder
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.logbook.test_run_folder import CONFIG
from tests.mcpilco.point import TINY

STEPS = 8
PLANT = {
    "format": 1,
    "plant": "mcpilco/CartPoleSwingUp-v0",
    "parameters": {"cart_mass": 0.6, "pole_mass": 0.42},
    "effects": [],
}
HEAVY = PLANT | {"parameters": {"cart_mass": 3.0}}
COMPONENTS = {
    "physics": ModelConfig(kernel="rbf", mean="physics", plant=PLANT),
    "features": ModelConfig(kernel="features+rbf", plant=PLANT),
    "friction": ModelConfig(kernel="friction+mpk"),
    "memory": ModelConfig(kernel="rbf", memory=2),
    "lags": ModelConfig(kernel="sed-mpk+rbf", memory=2),
    "filter": ModelConfig(kernel="sed-fir", memory=2),
    "delay": ModelConfig(kernel="rbf", delay=0.2),
    "part of a delay": ModelConfig(kernel="friction+rbf+mpk", delay=0.13),
    "missing forces": ModelConfig(kernel="gip+rbf", mean="physics", plant=HEAVY, uncertainty=0.0),
    "missing forces, memory": ModelConfig(kernel="gip+rbf", mean="physics", memory=1),
    "physics, memory": ModelConfig(kernel="rbf", mean="physics", memory=1),
}


def numbers(name: str) -> Config:
    return dataclasses.replace(TINY, model=COMPONENTS[name], horizon=STEPS)


def env() -> gymnasium.Env:
    return gymnasium.make("mcpilco/CartPoleSwingUp-v0", max_episode_steps=STEPS)


def make_agent(name: str) -> MCPILCO:
    return MCPILCO("SumOfGaussians", env(), config=numbers(name), seed=4)


DEARER = (
    "features",
    "part of a delay",
    "missing forces",
    "missing forces, memory",
    "physics, memory",
)
"""parts that others have too, and that take seconds together"""


def actions(agent: MCPILCO) -> np.ndarray:
    """What it answers in an episode, in which it may remember."""
    act = agent.controller()
    return np.array([act(x) for x in np.random.default_rng(0).normal(size=(5, 4))])


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=pytest.mark.slow) if n in DEARER else n for n in COMPONENTS],
)
def test_a_loaded_agent_acts_and_learns_as_the_saved_one(name, tmp_path):
    learned = make_agent(name).learn(2 * STEPS)
    saved = learned.save(tmp_path / "agent.npz")
    loaded = MCPILCO.load(saved, env())
    assert loaded.config == learned.config
    np.testing.assert_array_equal(actions(loaded), actions(learned))
    loaded.learn(STEPS), learned.learn(STEPS)
    first, second = (agent.save(tmp_path / "a").read_bytes() for agent in (loaded, learned))
    assert first == second
    assert loaded.results[-1].failure is None
    assert loaded.results[-1].prediction.states.shape[-1] == 4


def test_the_file_holds_numbers_only(tmp_path):
    saved = make_agent("physics").learn(2 * STEPS).save(tmp_path / "agent.npz")
    with np.load(saved, allow_pickle=False) as arrays:
        assert all(arrays[name].dtype.kind in "fiuSU" for name in arrays)
    about, groups = read_groups(saved)
    assert about["config"]["model"]["plant"] == PLANT
    assert groups["gp"]["physics.mean"].shape == (5,)


def test_a_file_of_another_model_is_refused(tmp_path):
    saved = make_agent("physics").learn(2 * STEPS).save(tmp_path / "agent.npz")
    about, groups = read_groups(saved)
    about["config"]["model"]["mean"] = "zero"
    write_groups(tmp_path / "other.npz", about, groups)
    with pytest.raises(RunFolderError, match="Saved GP does not fit"):
        MCPILCO.load(tmp_path / "other.npz", env())


def test_an_agent_remembers_its_inputs_and_forgets_them_at_a_start():
    agent = make_agent("memory").learn(2 * STEPS)
    x = np.array([0.1, 0.2, 0.3, 0.4])
    first, state = agent.predict(x)
    second, state = agent.predict(x, state)
    np.testing.assert_allclose(state[0], [*second, *first], rtol=1e-6)
    assert not np.allclose(first, second)
    again, _ = agent.predict(x[None], (state[0][None],), episode_start=np.array([True]))
    np.testing.assert_array_equal(again[0], first)
    with pytest.raises(InputError, match="pass None to begin"):
        agent.predict(x, (np.zeros(3),))
    states = agent.transitions.states
    np.testing.assert_array_equal(states[0, 4:], 0.0)
    np.testing.assert_array_equal(states[STEPS, 4:], 0.0)  # another episode
    np.testing.assert_array_equal(states[2, 4:], agent.transitions.inputs[[1, 0], 0])
    np.testing.assert_array_equal(agent.transitions.next_states[:-1][:7], states[1:8])


def test_a_policy_of_a_late_actuator_sees_the_state_that_its_input_will_act_on(monkeypatch):
    """As the model predicts it that has learned of the episode's own steps."""
    agent = make_agent("delay").learn(2 * STEPS)
    certain = torch.eye(4).expand(2, 4, 4)  # states are taken as they are measured
    monkeypatch.setattr(StateTracker, "_estimated", lambda self, *of: (of[-1], certain))
    seen = []
    agent.policy.forward = lambda states, *rest: seen.append(states) or states[..., :1]
    act = agent.controller()
    x = np.array([[0.1, 0.2, 0.3, 0.4], [0.3, -0.2, 0.5, 1.0]])
    inputs = [act(x), act(x + 0.1), act(x)]
    own = agent.transitions[:STEPS]  # the policy's own data
    for b in range(2):
        states = np.stack([x[b], x[b] + 0.1, x[b]])
        steps = Transitions(states[:-1], np.stack([u[b] for u in inputs[:2]]), states[1:])
        steps = steps.after_inputs(2)
        dynamics = agent.model.dynamics(own + steps)
        ahead = torch.from_numpy(x[b : b + 1])
        for u in inputs[:2]:  # those on their way, the older one first
            u = torch.from_numpy(u[b : b + 1]).double()
            mean, _ = dynamics.posterior.mean_and_variance(dynamics.regressors(ahead, u))
            ahead = dynamics.advance(ahead, u, mean)
        torch.testing.assert_close(seen[2][b : b + 1], ahead, rtol=1e-5, atol=1e-5)
    assert seen[0].shape == (2, 4)


@pytest.mark.parametrize("name", ["delay", pytest.param("part of a delay", marks=pytest.mark.slow)])
def test_policies_of_a_late_actuator_are_searched_behind_what_they_will_act_behind(name):
    agent = make_agent(name).learn(2 * STEPS)
    observer = agent._problem(2, None).observer
    assert isinstance(observer.estimator, DelayModel)
    assert observer.estimator.delay == agent.model.delay
    assert torch.equal(observer.noise_std, agent.tracker.noise_std)
    assert (observer.noise_std > 0).all()


def test_what_an_episode_has_taught_ends_with_it():
    agent = make_agent("part of a delay").learn(2 * STEPS)
    x = np.array([[0.1, 0.2, 0.3, 0.4], [0.3, -0.2, 0.5, 1.0]])
    first, state = agent.predict(x)
    _, state = agent.predict(x + 0.3, state)
    going_on, _ = agent.predict(x, state)
    one_begins, _ = agent.predict(x, state, episode_start=np.array([True, False]))
    np.testing.assert_allclose(one_begins, [first[0], going_on[1]], rtol=1e-6)
    assert not np.isclose(first[1], going_on[1])
    for foreign in ((np.zeros(2),), (state[0].states,), (), state[0]):
        with pytest.raises(InputError, match="pass None to begin"):
            agent.predict(x, foreign)


def test_the_particles_of_a_late_actuator_are_shown_when_they_will_be_there():
    result = make_agent("delay").learn(2 * STEPS).results[-1]
    states, costs = result.prediction.states, result.prediction.costs
    np.testing.assert_array_equal(states[:2], states[[2, 2]])
    assert (states[3:] != states[2:-1]).any((1, 2)).all()
    np.testing.assert_array_equal(costs[:2], costs[[2, 2]])
    assert (len(states), len(costs)) == (STEPS + 1, STEPS)


def test_a_run_folder_holds_the_rows_that_were_learned_from(tmp_path):
    agent = make_agent("memory")
    run = RunFolder.create(tmp_path / "run", CONFIG)
    agent.learn(2 * STEPS, callback=Recorder(run))
    rows = read_transitions(run, 0) + read_transitions(run, 1)
    for name, array in vars(agent.transitions).items():
        np.testing.assert_array_equal(getattr(rows, name), array)


def positions() -> gymnasium.Env:
    return gymnasium.make("mcpilco/CartPoleSwingUpPositions-v0", max_episode_steps=STEPS)


def test_states_that_are_measured_in_part_hold_no_inputs():
    with pytest.raises(InputError, match="memory must be 0"):
        MCPILCO("SumOfGaussians", positions(), config=numbers("memory"))


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", ["delay", "part of a delay"])
@pytest.mark.parametrize("engine", [pytest.param("fused", marks=pytest.mark.slow), "eager"])
def test_a_state_measured_in_part_and_a_late_actuator_can_be_had_together(name, engine, tmp_path):
    config = dataclasses.replace(numbers(name), engine=engine)
    agent = MCPILCO("SumOfGaussians", positions(), config=config, seed=4).learn(3 * STEPS)
    assert [result.failure for result in agent.results] == [None, None]
    problem = agent._problem(3, agent.perception)
    chain = problem.observer.estimator
    assert isinstance(chain, Chain)
    assert isinstance(chain.first, LinearEstimator)
    assert isinstance(chain.second, DelayModel)
    assert (problem.rollout is rollout) == (engine == "eager")

    # on the system the policy acts on the prediction from the estimates, by the same protocol
    record, seen = agent.results[-1].rollout, []
    forward = agent.policy.forward
    agent.policy.forward = lambda states, *rest: seen.append(states) or forward(states, *rest)
    act = agent.controller()
    for observation in record.observations[:-1]:
        act(observation)
    tracker, memory = agent.tracker, agent.tracker.begin(seen[0])
    measured, chained = agent.perception.estimator, agent.perception.estimator.begin(seen[0])
    for t, observation in enumerate(record.observations[:-1]):
        estimate, chained = measured.observe(torch.from_numpy(observation), chained)
        ahead, memory = tracker.observe(estimate, memory)
        torch.testing.assert_close(seen[t], ahead)
        memory = tracker.after(memory, forward(ahead).detach())
    assert not torch.allclose(seen[-1], estimate)

    loaded = MCPILCO.load(agent.save(tmp_path / "agent.npz"), positions())
    agent.policy.forward = forward
    acts = agent.controller(), loaded.controller()
    for observation in record.observations[:-1]:
        np.testing.assert_array_equal(*(act(observation) for act in acts))


def test_with_part_of_the_states_the_error_of_the_estimates_counts_as_noise():
    agent = MCPILCO("SumOfGaussians", positions(), config=numbers("delay"), seed=4)
    agent.learn(2 * STEPS)
    std = torch.from_numpy(agent.perception.estimate_std)
    agent.look_ahead()
    assert (agent.tracker.noise_std >= std).all()
    assert (std > 0).all()


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"kernel": "rbf+rbf"}, "different parts"),
        ({"kernel": "cubic"}, "different parts"),
        ({"kernel": "gip+rbf"}, "choose mean physics"),
        ({"kernel": "gip", "mean": "physics"}, "another part learns the rest"),
        ({"memory": -1}, "memory must be at least 0"),
        ({"delay": -0.1}, "delay must be at least 0"),
        ({"delay": 0.1, "memory": 1}, "delay goes with memory 0"),
        ({"delay": 0.1, "sampling": "path"}, "and sampling step"),
        ({"delay": 0.1, "mean": "physics"}, "know no plant"),
        ({"delay": 0.1, "kernel": "features+rbf"}, "know no plant"),
        ({"kernel": "sed-mpk+rbf"}, "choose a memory of at least 1"),
        ({"kernel": "sed-fir"}, "sed-fir is of past inputs"),
        ({"kernel": "sed-fir", "memory": 2, "sampling": "path"}, "and sampling step"),
        ({"kernel": "sed-mpk", "memory": 2, "delay": 0.1}, "delay goes with memory 0"),
        ({"plant_step": 0.0}, "plant_step must be positive"),
        ({"mean": "physics", "sampling": "path"}, "sampling path"),
        ({"kernel": "friction+rbf", "sampling": "path"}, "sampling path"),
    ],
)
def test_a_model_that_cannot_be_is_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        ModelConfig(**wrong)
