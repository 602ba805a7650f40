from __future__ import annotations

import dataclasses
import json
import subprocess
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from mcpilco.logbook import Callback, History, JsonLines, PastTrial, RunFolder
from mcpilco.logbook.callbacks import CallbackList
from mcpilco.show.film import Follower, Reel, write_run_film
from mcpilco.show.recorder import Recorder
from mcpilco.show.viewer import _executable
from mcpilco.typing import InputError
from tests.mcpilco.fakes import DT, STEPS, FakeAgent, make_prediction, make_rollout
from tests.mcpilco.logbook.test_run_folder import CONFIG

PAUSE = 5
"""steps of 0.1 s in half a second"""


def past(number: int, seed: int = 0) -> PastTrial:
    rollout = make_rollout(10 * seed + number)
    row = {"experience_s": 0.6 * number, "predicted_cost": 4.0, "real_cost": 5.0, "success": True}
    prediction = make_prediction(STEPS, seed) if number else None
    return PastTrial(number, rollout, 1 - rollout.rewards, prediction, row if number else {})


def reel(task, name="run", numbers=(0, 1, 2), seed=0) -> Reel:
    trials = tuple(past(number, seed) for number in numbers)
    return Reel(History(RunFolder(Path(name), CONFIG), task, trials, ()))


def rows(path, entity) -> tuple[np.ndarray, list]:
    """Times [s] and values of the scalars of one entity, in order."""
    found = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.lstrip("/") == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            (name,) = [n for n in batch.schema.names if n.endswith("scalars")]
            times = [time.total_seconds() for time in batch.column("sim_time").to_pylist()]
            found += zip(times, batch.column(name).to_pylist(), strict=True)
    found.sort(key=lambda row: row[0])
    return np.array([time for time, _ in found]), [value for _, value in found]


def entities(path) -> set[str]:
    return {chunk.entity_path.lstrip("/") for chunk in RrdReader(path).stream()}


def test_trials_follow_one_another_with_a_pause(tmp_path, task) -> None:
    end_s = write_run_film(tmp_path / "film.rrd", [reel(task)])
    times, values = rows(tmp_path / "film.rrd", "states/pole_angle/system")
    slot = DT * (STEPS + PAUSE)
    starts = [0.0, slot, 2 * slot]
    expected = np.concatenate([start + DT * np.arange(STEPS + 2) for start in starts])
    np.testing.assert_allclose(times, expected, atol=1e-9)
    assert end_s == pytest.approx(2 * slot + DT * STEPS)
    here = np.ravel(values)[STEPS + 2 : 2 * STEPS + 3]
    np.testing.assert_array_equal(here, past(1).rollout.states[:, 2])


def test_curves_are_broken_between_trials(tmp_path, task) -> None:
    write_run_film(tmp_path / "film.rrd", [reel(task)])
    for entity in ("states/pole_angle/system", "states/pole_angle/particles", "cost/system"):
        _, values = rows(tmp_path / "film.rrd", entity)
        gaps = [np.isnan(value).all() for value in values]
        assert sum(gaps) == (2 if "particles" in entity else 3)
        assert gaps[-1]


def test_cost_of_a_trial_is_a_level_throughout_it(tmp_path, task) -> None:
    write_run_film(tmp_path / "film.rrd", [reel(task)])
    for name, cost in (("predicted", 4.0), ("system", 5.0)):
        times, values = rows(tmp_path / "film.rrd", f"learning/{name}")
        assert times[0] == pytest.approx(DT * (STEPS + PAUSE))  # the exploration has none
        assert {value for (value,) in values if not np.isnan(value)} == {cost}


def test_one_trial_of_a_run_is_a_film_of_its_own(tmp_path, task) -> None:
    end_s = write_run_film(tmp_path / "film.rrd", [reel(task)], trial=2)
    times, _ = rows(tmp_path / "film.rrd", "states/pole_angle/system")
    assert len(times) == STEPS + 2
    assert end_s == pytest.approx(DT * STEPS)
    with pytest.raises(InputError, match="--trial must be one of 0, 1, 2, got 7"):
        write_run_film(tmp_path / "other.rrd", [reel(task)], trial=7)
    assert [path.name for path in tmp_path.iterdir()] == ["film.rrd"]


def test_trials_of_two_runs_begin_together(tmp_path, task) -> None:
    reels = [reel(task, "a"), reel(task, "b", numbers=(0, 2), seed=1)]
    write_run_film(tmp_path / "film.rrd", reels)
    slot = DT * (STEPS + PAUSE)
    first, _ = rows(tmp_path / "film.rrd", "states/pole_angle/a/system")
    second, values = rows(tmp_path / "film.rrd", "states/pole_angle/b/system")
    assert len(first) == 3 * (STEPS + 2)
    np.testing.assert_allclose(second[[0, STEPS + 2]], [0.0, 2 * slot], atol=1e-9)
    here = np.ravel(values)[STEPS + 2 : 2 * STEPS + 3]
    np.testing.assert_array_equal(here, past(2, seed=1).rollout.states[:, 2])


def test_scenes_of_two_runs_are_drawn_apart(tmp_path, task) -> None:
    import gymnasium as gym

    import envs  # noqa: F401

    scene = gym.make(CONFIG["env"]).unwrapped.scene
    reels = [
        dataclasses.replace(reel(task, name, seed=seed), scene=scene)
        for seed, name in enumerate("ab")
    ]
    write_run_film(tmp_path / "film.rrd", reels)
    found = entities(tmp_path / "film.rrd")
    for group in "ab":
        assert {f"world/{group}/tail", f"world/{group}/particles"} <= found
    assert not any("observed" in entity for entity in found)


def test_runs_of_two_systems_make_no_film(tmp_path, task) -> None:
    other = dataclasses.replace(task, state_names=("x", "dx", "q", "dq"))
    with pytest.raises(InputError, match="of one system; the first has the state_names"):
        write_run_film(tmp_path / "film.rrd", [reel(task), reel(other)])


def content(path) -> list[str]:
    """What a film holds, but for the rows' own names. `rerun rrd compare` tells NaN from NaN."""
    found = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        kept = [name for name in batch.schema.names if "RowId" not in name]
        found.append(f"{chunk.entity_path}: {batch.select(kept).to_pydict()}")
    return sorted(found)


def test_equal_runs_make_equal_films(tmp_path, task) -> None:
    for name, seed in (("a", 0), ("b", 0), ("c", 3)):
        write_run_film(tmp_path / f"{name}.rrd", [reel(task, seed=seed)])
    first, again, other = (content(tmp_path / f"{name}.rrd") for name in "abc")
    assert first == again
    assert first != other


def test_film_is_verified_by_rerun(tmp_path, task) -> None:
    path = tmp_path / "film.rrd"
    write_run_film(path, [reel(task)])
    command = [_executable(), "rrd", "verify", str(path)]
    assert subprocess.run(command, capture_output=True).returncode == 0


EPISODE = 5


class Looks(Callback):
    """Looks at the run after each event, and notes how many rollouts were seen by then."""

    def __init__(self, follower: Follower) -> None:
        self.follower = follower
        self.seen: list[int] = []
        self.finished: list[bool] = []

    def look(self) -> None:
        self.follower.look()
        self.seen.append(len(self.follower._seen))
        self.finished.append(self.follower.finished)

    def on_training_start(self, agent, trials):
        self.look()

    def on_exploration(self, rollout):
        self.look()

    def on_policy_step(self, step, steps, values):
        self.look()

    def on_trial_end(self, result):
        self.look()

    def on_training_end(self):
        self.look()


@pytest.fixture
def run(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG)


@pytest.fixture
def watched(run, tmp_path):
    """A training of two trials that was looked at throughout, and what the viewer was sent."""
    import envs  # noqa: F401

    rec = rr.RecordingStream("mcpilco", send_properties=False)
    rec.save(tmp_path / "sent.rrd")
    looks = Looks(Follower(run, None, rec))
    agent = FakeAgent("SumOfGaussians", gym.make(CONFIG["env"], max_episode_steps=EPISODE))
    agent.learn(3 * EPISODE, CallbackList([JsonLines(run.policy_steps_path), Recorder(run), looks]))
    rec.disconnect()
    return looks, tmp_path / "sent.rrd"


def test_each_rollout_is_shown_once_it_is_whole(watched) -> None:
    looks, _ = watched
    # start, exploration, three steps, trial 1, three steps, trial 2, end
    assert looks.seen == [0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3]
    assert looks.finished == [False] * 10 + [True]


def test_viewer_is_sent_every_step_of_every_rollout_once(watched) -> None:
    _, sent = watched
    found = [
        chunk.num_rows
        for chunk in RrdReader(sent).stream()
        if chunk.entity_path == "/states/pole_angle/system" and not chunk.is_static
    ]
    assert sum(found) == 3 * (EPISODE + 2)


def test_viewer_is_told_how_the_search_goes(watched) -> None:
    _, sent = watched
    text = str(
        [
            chunk.to_record_batch().to_pylist()
            for chunk in RrdReader(sent).stream()
            if chunk.entity_path == "/about"
        ]
    )
    assert "trial 2: searching the policy" in text
    assert "3 steps, the models expect a cost of **1.67**" in text  # 5 / 3


def test_folder_that_does_not_tell_anything_yet_is_waited_for(run, tmp_path) -> None:
    rec = rr.RecordingStream("mcpilco", send_properties=False)
    rec.save(tmp_path / "sent.rrd")
    follower = Follower(run, None, rec)
    run.policy_steps_path.write_text(json.dumps({"time/trial": 1, "time/step": 1}))
    follower.look()
    assert not follower.finished
