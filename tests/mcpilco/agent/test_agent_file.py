"""Laws of a saved agent: it acts as before, goes on as before, and a hostile file does nothing."""

from __future__ import annotations

import dataclasses
import io
import json
import math
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mcpilco.agent.agent import MCPILCO
from mcpilco.agent.contract import AbsentEnv
from mcpilco.files import read_arrays, read_groups, write_arrays, write_groups
from mcpilco.typing import EnvError, InputError, McPilcoError, RunFolderError
from tests.mcpilco.point import STEPS, TASK, TINY, PointEnv

OBSERVATIONS = np.random.default_rng(0).normal(size=(20, 2))


def make_agent(seed: int = 3) -> MCPILCO:
    return MCPILCO("SumOfGaussians", PointEnv(), config=TINY, seed=seed)


@pytest.fixture(scope="module")
def learned() -> MCPILCO:
    return make_agent().learn(3 * STEPS)


@pytest.fixture(scope="module")
def saved(learned: MCPILCO, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return learned.save(tmp_path_factory.mktemp("agent") / "agent.npz")


def assert_same_actions(first: MCPILCO, second: MCPILCO) -> None:
    actions, again = (agent.predict(OBSERVATIONS)[0] for agent in (first, second))
    assert actions.dtype == again.dtype
    np.testing.assert_array_equal(actions, again)


# --- what is kept


@pytest.mark.parametrize("env", [PointEnv(), None], ids=["env", "no env"])
def test_a_loaded_agent_is_the_saved_one(learned: MCPILCO, saved: Path, env) -> None:
    agent = MCPILCO.load(saved, env)
    assert_same_actions(agent, learned)
    assert agent.config == learned.config
    assert (agent.seed, agent.trials, agent.num_timesteps) == (3, 2, 3 * STEPS)
    assert agent.reference_cost == learned.reference_cost
    assert agent.horizon == learned.horizon
    assert (agent.low, agent.high) == (learned.low, learned.high)
    for name, array in vars(learned.transitions).items():
        np.testing.assert_array_equal(getattr(agent.transitions, name), array)


def test_a_loaded_model_predicts_the_same(learned: MCPILCO, saved: Path) -> None:
    agent = MCPILCO.load(saved, PointEnv())
    states, inputs = torch.from_numpy(OBSERVATIONS), torch.ones(20, 1, dtype=torch.float64)
    noise = torch.ones(20, 1, dtype=torch.float64)
    mine, its = (a.model.dynamics(learned.transitions).step for a in (learned, agent))
    torch.testing.assert_close(its(states, inputs, noise), mine(states, inputs, noise))


def test_saving_twice_gives_equal_files(saved: Path, tmp_path: Path) -> None:
    again = MCPILCO.load(saved, PointEnv()).save(tmp_path / "again.npz")
    assert again.read_bytes() == saved.read_bytes()


@pytest.mark.parametrize("name", ["agent", "agent.npz", "agent.v2", "agent.v2.npz"])
def test_a_name_keeps_its_dots(learned: MCPILCO, tmp_path: Path, name: str) -> None:
    path = learned.save(str(tmp_path / name))
    assert path == tmp_path / (name.removesuffix(".npz") + ".npz")
    assert_same_actions(MCPILCO.load(tmp_path / name), learned)


def test_an_agent_that_has_learned_nothing_survives_too(tmp_path: Path) -> None:
    fresh = MCPILCO.load(make_agent().save(tmp_path / "fresh"), PointEnv())
    assert fresh.transitions is None
    fresh.learn(2 * STEPS)
    expected = make_agent().learn(2 * STEPS)
    assert fresh.results[0].predicted_cost == expected.results[0].predicted_cost
    assert fresh.results[0].real_cost == expected.results[0].real_cost


# --- going on


def test_learning_goes_on_with_the_next_trial_and_the_last_policy(saved: Path) -> None:
    agent = MCPILCO.load(saved, PointEnv())
    slow = tuple(dataclasses.replace(phase, learning_rate=1e-12) for phase in TINY.search.phases)
    agent.config = dataclasses.replace(
        agent.config, search=dataclasses.replace(TINY.search, phases=slow)
    )
    before = agent.policy.centres.detach().clone()
    agent.learn(STEPS)
    assert [(r.trial, r.experience_s) for r in agent.results] == [(3, 3.6)]
    assert (agent.trials, agent.num_timesteps) == (3, 4 * STEPS)
    torch.testing.assert_close(agent.policy.centres.detach(), before)


def test_a_loaded_agent_learns_what_the_saved_one_would_have_learned(
    saved: Path, tmp_path: Path
) -> None:
    """To the last bit: searches, the env's starts and noises, and the file that comes of them."""
    uninterrupted = make_agent().learn(5 * STEPS)
    resumed = MCPILCO.load(saved, PointEnv()).learn(2 * STEPS)
    for mine, its in zip(resumed.results, uninterrupted.results[2:], strict=True):
        assert (mine.trial, mine.predicted_cost) == (its.trial, its.predicted_cost)
        np.testing.assert_array_equal(mine.prediction.states, its.prediction.states)
        np.testing.assert_array_equal(mine.rollout.observations, its.rollout.observations)
    first, second = (agent.save(tmp_path / "a").read_bytes() for agent in (uninterrupted, resumed))
    assert first == second


def test_an_agent_of_the_first_format_is_read(
    learned: MCPILCO, saved: Path, tmp_path: Path
) -> None:
    about, groups = read_groups(saved)
    groups["generator"] = {"state": np.zeros(5056, np.uint8)}
    older = {**about, "format": 1, "exploration": {"bit_generator": "PCG64"}}
    agent = MCPILCO.load(write_groups(tmp_path / "older.npz", older, groups), PointEnv())
    assert_same_actions(agent, learned)
    assert agent.learn(STEPS).trials == 3


def test_without_an_env_learning_is_answered_with_a_sentence(saved: Path) -> None:
    agent = MCPILCO.load(saved)
    assert isinstance(agent.env, AbsentEnv)
    with pytest.raises(EnvError, match=r"loaded without an env.*MCPILCO.load\(path, env\)"):
        agent.learn(STEPS)
    assert agent.trials == 2


def test_an_agent_without_an_env_can_be_saved_again(saved: Path, tmp_path: Path) -> None:
    again = MCPILCO.load(MCPILCO.load(saved).save(tmp_path / "again"), PointEnv())
    assert_same_actions(again, MCPILCO.load(saved))


# --- what does not fit


def env_of(**entries: Any) -> PointEnv:
    env = PointEnv()
    env.task = dataclasses.replace(TASK, **entries)
    return env


@pytest.mark.parametrize(
    ("env", "message"),
    [
        (env_of(state_names=("angle", "velocity")), "state_names"),
        (env_of(velocities=()), "velocities"),
        (env_of(angles=(0,)), "angles"),
        (env_of(dt=0.1), r"its dt is 0.2, the env has 0.1"),
    ],
)
def test_an_env_with_another_meaning_is_refused(saved: Path, env: PointEnv, message: str) -> None:
    with pytest.raises(RunFolderError, match=f"holds no agent of this env.*{message}"):
        MCPILCO.load(saved, env)


def test_a_wrong_env_is_no_damaged_file(saved: Path) -> None:
    with pytest.raises(EnvError, match="NoSuchEnv"):
        MCPILCO.load(saved, "NoSuchEnv-v0")


@pytest.mark.parametrize("path", [None, 5, b"agent"])
def test_what_is_no_path_is_answered_with_a_sentence(learned: MCPILCO, path: Any) -> None:
    for act in (learned.save, MCPILCO.load):
        with pytest.raises(InputError, match="has a path, such as 'agent.npz', got "):
            act(path)


def test_a_folder_is_no_agent(learned: MCPILCO, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for path in (tmp_path, ".", ".."):
        for act in (learned.save, MCPILCO.load):
            with pytest.raises(
                RunFolderError, match="is a folder; name the file in it, .*agent.npz"
            ):
                act(path)


def test_an_unwritable_place_is_answered_with_a_sentence(learned: MCPILCO, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(RunFolderError, match="Cannot write"):
        learned.save(tmp_path / "file" / "agent")
    with pytest.raises(RunFolderError, match="There is no file"):
        MCPILCO.load(tmp_path / "none")


def without(group: str, name: str) -> Callable:
    return lambda about, groups: groups[group].pop(name)


def with_array(group: str, name: str, array: Any) -> Callable:
    return lambda about, groups: groups.setdefault(group, {}).update({name: np.asarray(array)})


def with_entry(name: str, value: Any) -> Callable:
    return lambda about, groups: about.update({name: value})


def with_width(width: int) -> Callable:
    """Transitions that fit one another, of another env."""

    def damage(about: dict, groups: dict) -> None:
        for name in ("states", "next_states"):
            groups["transitions"][name] = np.ones((3 * STEPS, width))

    return damage


@pytest.mark.parametrize(
    "damage",
    [
        without("policy", "weights"),
        without("gp", "noise_floor"),
        without("bounds", "low"),
        without("transitions", "inputs"),
        with_array("policy", "weights", np.ones((6, 2))),
        with_array("policy", "weights", np.full((6, 1), np.nan)),
        with_array("policy", "weights", np.array(["a"])),
        with_array("policy", "more", 1.0),
        with_array("transitions", "states", np.ones((3 * STEPS, 5))),
        with_array("transitions", "states", np.ones((2, 2))),
        with_array("transitions", "states", np.full((3 * STEPS, 2), np.inf)),
        with_array("transitions", "more", np.ones(2)),
        with_width(3),
        with_array("bounds", "low", "a"),
        with_entry("format", 99),
        with_entry("format", None),
        with_entry("config", {"engine": "gpu"}),
        with_entry("config", []),
        with_entry("task", {}),
        with_entry("task", {"cost": "print()"}),
        with_entry("seed", "zero"),
        with_entry("seed", -1),
        with_entry("trials", "two"),
        with_entry("trials", -2),
        with_entry("trials", True),
        with_entry("trials", 1.5),
        with_entry("reference_cost", None),
        with_entry("reference_cost", math.inf),
        with_entry("config", {"policy": {"bases": 10**9}}),
        with_entry("config", {"model": {"degree": 10**9}}),
        lambda about, groups: groups.pop("transitions"),
        with_entry("horizon", "long"),
    ],
)
@pytest.mark.usefixtures("unchecked_shapes")
def test_a_damaged_entry_is_answered_with_a_sentence(
    saved: Path, tmp_path: Path, damage: Callable
) -> None:
    about, groups = read_groups(saved)
    damage(about, groups)
    path = write_groups(tmp_path / "damaged.npz", about, groups)
    with pytest.raises(RunFolderError, match=r"damaged.npz"):
        MCPILCO.load(path)


def test_a_pickle_in_the_file_is_not_executed(saved: Path, tmp_path: Path) -> None:
    mark = tmp_path / "executed"

    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(mark),))

    buffer = io.BytesIO()
    np.save(buffer, np.array([Bomb()], dtype=object), allow_pickle=True)
    for member in ("about.npy", "policy/weights.npy"):
        path = tmp_path / "bomb.npz"
        with zipfile.ZipFile(saved) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                target.writestr(name, buffer.getvalue() if name == member else source.read(name))
        with pytest.raises(RunFolderError, match="plain arrays"):
            MCPILCO.load(path, PointEnv())
    assert not mark.exists()


@pytest.mark.parametrize("keep", [0, 10, 1000, -1])
def test_a_truncated_file_is_answered_with_a_sentence(
    saved: Path, tmp_path: Path, keep: int
) -> None:
    path = tmp_path / "short.npz"
    path.write_bytes(saved.read_bytes()[:keep])
    with pytest.raises(RunFolderError, match="damaged"):
        MCPILCO.load(path, PointEnv())


def test_arrays_of_something_else_are_answered_with_a_sentence(tmp_path: Path) -> None:
    path = write_arrays(tmp_path / "other.npz", {"about": np.array(json.dumps({"x": 1}))})
    with pytest.raises(RunFolderError, match="format None, this mcpilco reads"):
        MCPILCO.load(path)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-3, 3) | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=4,
)


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(data=st.data())
@pytest.mark.usefixtures("unchecked_shapes")
def test_any_change_of_what_the_file_says_is_read_or_answered_with_a_sentence(
    saved: Path, tmp_path: Path, data: st.DataObject
) -> None:
    arrays = read_arrays(saved)
    about = json.loads(str(arrays["about"]))
    place = about
    while isinstance(place, dict) and place:
        parent, name = place, data.draw(st.sampled_from(sorted(place)))
        place = place[name]
    parent[name] = data.draw(json_values)
    arrays["about"] = np.array(json.dumps(about))
    try:
        agent = MCPILCO.load(write_arrays(tmp_path / "changed.npz", arrays))
    except McPilcoError:
        return
    assert np.isfinite(agent.predict(OBSERVATIONS)[0]).all()
