from __future__ import annotations

import numpy as np
import pytest

from mcpilco.logbook import Callback, RunFolder
from mcpilco.logbook.callbacks import CallbackList
from mcpilco.show.recorder import Recorder
from mcpilco.typing import EnvError
from tests.mcpilco.fakes import FakeAgent, make_prediction
from tests.mcpilco.logbook.test_run_folder import CONFIG

gym = pytest.importorskip("gymnasium")
STEPS = 5


@pytest.fixture
def agent():
    import envs  # noqa: F401

    return FakeAgent("SumOfGaussians", gym.make(CONFIG["env"], max_episode_steps=STEPS))


@pytest.fixture
def run(tmp_path):
    return RunFolder.create(tmp_path / "run", CONFIG)


def test_run_folder_holds_all_that_is_promised(run, agent):
    agent.learn(3 * STEPS, Recorder(run))
    names = {"policy", "gp", "transitions", "rollout", "particles"}
    expected = {"config.json", "task.json", "metrics.csv", "summary.json", "agent.npz"}
    expected |= {f"rollouts/{trial:02d}.rrd" for trial in (0, 1, 2)}
    expected |= {"trials/00/rollout.npz", "trials/00/transitions.npz"}
    expected |= {f"trials/{trial:02d}/{name}.npz" for trial in (1, 2) for name in names}
    expected |= {f"trials/{trial:02d}/result.json" for trial in (1, 2)}
    files = {
        path.relative_to(run.path).as_posix() for path in run.path.rglob("*") if path.is_file()
    }
    assert files == expected


def test_rollout_and_particles_are_those_of_the_trial(run, agent):
    agent.learn(3 * STEPS, Recorder(run))
    for result in agent.results:
        rollout = run.read_arrays(result.trial, "rollout")
        rows = run.read_arrays(result.trial, "transitions")
        np.testing.assert_array_equal(rollout["observations"], result.rollout.observations)
        np.testing.assert_array_equal(rollout["states"], result.rollout.states)
        np.testing.assert_array_equal(rows["next_states"], result.rollout.observations[1:])
        particles = run.read_arrays(result.trial, "particles")
        expected = make_prediction(len(result.rollout), result.trial)
        np.testing.assert_array_equal(particles["costs"], expected.costs)


def test_each_trial_keeps_its_own_policy(run, agent):
    agent.learn(3 * STEPS, Recorder(run))
    biases = [run.read_arrays(trial, "policy")["bias"].item() for trial in (1, 2)]
    assert biases == [1.0, 2.0]


def test_summary_tells_the_last_trial(run, agent):
    agent.learn(3 * STEPS, Recorder(run))
    summary, last = run.summary(), agent.results[-1]
    assert summary["trials"] == 2
    assert summary["real_cost"] == last.real_cost
    assert summary["success"] is last.success
    assert summary["wall_s"] > 0


def test_interrupted_run_keeps_whole_trials_and_has_no_summary(run, agent):
    class Fails(Callback):
        def on_model_fitted(self, values):
            if agent.results:
                raise EnvError

    with pytest.raises(EnvError):
        agent.learn(4 * STEPS, CallbackList([Recorder(run), Fails()]))
    assert run.finished_trials() == [1]
    assert run.summary() is None
    assert run.agent_path.exists()


def test_equal_seeds_give_equal_files(tmp_path):
    import envs  # noqa: F401

    runs = []
    for name in "ab":
        env = gym.make(CONFIG["env"], max_episode_steps=STEPS)
        runs.append(RunFolder.create(tmp_path / name, CONFIG))
        FakeAgent("SumOfGaussians", env, seed=1).learn(3 * STEPS, Recorder(runs[-1]))
    first, second = (
        {p.relative_to(run.path): p.read_bytes() for p in run.path.rglob("*.npz")} for run in runs
    )
    assert first == second
    assert len(first) == 13
    metrics = [(run.path / "metrics.csv").read_bytes() for run in runs]
    assert metrics[0] == metrics[1]
