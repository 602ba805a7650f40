from __future__ import annotations

import json

import pytest
import rerun as rr
from rerun.chunk import RrdReader

from mcpilco.logbook import Callback, JsonLines, RunFolder
from mcpilco.logbook.callbacks import CallbackList
from mcpilco.show.follow import Follower
from mcpilco.show.recorder import Recorder
from tests.mcpilco.fakes import FakeAgent
from tests.mcpilco.logbook.test_run_folder import CONFIG

gym = pytest.importorskip("gymnasium")
STEPS = 5


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
    agent = FakeAgent("SumOfGaussians", gym.make(CONFIG["env"], max_episode_steps=STEPS))
    agent.learn(3 * STEPS, CallbackList([JsonLines(run.policy_steps_path), Recorder(run), looks]))
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
    assert sum(found) == 3 * (STEPS + 2)


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
