"""Laws of `mcpilco record`: what the sensors saw, a file a rollout, nothing lost."""

from __future__ import annotations

import dataclasses
import sys

import gymnasium as gym
import numpy as np
import pytest

import mcpilco.crossing.rollouts as rollouts_module
import mcpilco.machine.env  # noqa: F401  registers its env before a test copies the registry
from mcpilco.agent import BrokenEpisodeError
from mcpilco.cli import main
from mcpilco.config import PRESETS
from mcpilco.data import Rollout
from mcpilco.recordings import from_rollout, read_recording
from mcpilco.task import TaskSpec
from tests.mcpilco.point import TINY
from tests.mcpilco.rigs import rig

STATES = ("cart_position", "cart_velocity", "pole_angle", "pole_velocity")
SHORT = ["--seconds", "3", "--rollouts", "2", "--quiet"]


def record(folder, *arguments: str) -> int:
    return main(["record", "--out", str(folder), *SHORT, *arguments])


def read(path):
    return read_recording(path, STATES, ("force",), velocities=((0, 1), (2, 3)))


def refused(capsys, *arguments: str) -> str:
    assert main(["record", *arguments]) == 2
    return capsys.readouterr().err.strip().splitlines()[-1].removeprefix("mcpilco: error: ")


@pytest.mark.parametrize("policy", ["excitation", "random"])
def test_a_file_a_rollout_is_written_and_can_be_read(tmp_path, policy) -> None:
    assert record(tmp_path, "--policy", policy, "--dt", "0.02") == 0
    paths = sorted(tmp_path.iterdir())
    assert [path.name for path in paths] == [f"{policy}-seed0-0{k}.csv" for k in range(2)]
    for path in paths:
        recording = read(path)
        assert recording.dt == pytest.approx(0.02)
        assert recording.time[-1] == pytest.approx(1.5)
        assert np.isfinite(recording.states).all()
        assert np.abs(recording.inputs).max() <= 10


def test_a_machine_is_recorded_and_its_own_log_kept(tmp_path) -> None:
    with rig() as machine:
        patient = ["--machine-kwargs", "watchdog=2", "silence=2"]
        typed = ["--machine", machine.address, *patient, "--dt", "0.02", "--seconds", "1"]
        assert record(tmp_path, *typed, "--rollouts", "1") == 0
    assert read(tmp_path / "excitation-seed0-00.csv").time[-1] == pytest.approx(1.0)
    log = tmp_path / "machine" / "episode-0000.csv"
    assert read(log).state_names == STATES
    # The file itself: read onto even steps, rows are masked wherever a busy host let the rig wait.
    assert np.isfinite(np.loadtxt(log, delimiter=",", skiprows=1)).all()


def test_a_rollout_that_breaks_off_is_recorded_again(tmp_path, monkeypatch, caplog) -> None:
    run, tried = rollouts_module.run_episode, []

    def fragile(env, act, steps, dt, seed):
        tried.append(seed)
        if len(tried) == 1:
            raise BrokenEpisodeError("a sensor jumped", run(env, act, 3, dt, seed=seed))
        return run(env, act, steps, dt, seed=seed)

    monkeypatch.setattr(rollouts_module, "run_episode", fragile)
    assert record(tmp_path, "--rollouts", "1") == 0
    assert record(tmp_path / "again", "--rollouts", "1") == 0
    assert tried == [tried[0]] * 3
    assert "excitation-seed0-00 is recorded again: a sensor jumped" in caplog.text
    first, second = sorted(tmp_path.rglob("*.csv"))
    assert first.read_bytes() == second.read_bytes()


def test_an_address_that_is_none_is_refused(tmp_path, capsys) -> None:
    out = str(tmp_path / "out")
    assert "udp://HOST:PORT" in refused(capsys, "--out", out, "--machine", "127.0.0.1:9000")


def test_rollouts_may_be_longer_than_the_envs_time_limit(tmp_path) -> None:
    assert record(tmp_path, "--seconds", "8", "--rollouts", "1") == 0
    (path,) = tmp_path.iterdir()
    assert read(path).time[-1] == pytest.approx(8.0)


def test_equal_seeds_give_equal_files_and_rollouts_differ(tmp_path) -> None:
    for name in "ab":
        assert record(tmp_path / name, "--seed", "3") == 0
    contents = [p.read_bytes() for p in sorted(tmp_path.rglob("*.csv"))]
    assert contents[:2] == contents[2:]
    assert contents[0] != contents[1]


def test_the_file_holds_what_was_measured_and_applied(tmp_path, monkeypatch) -> None:
    rollouts = []
    genuine = rollouts_module.run_episode

    def keep(*arguments, **options):
        rollouts.append(genuine(*arguments, **options))
        return rollouts[-1]

    monkeypatch.setattr(rollouts_module, "run_episode", keep)
    assert record(tmp_path) == 0
    for path, rollout in zip(sorted(tmp_path.iterdir()), rollouts, strict=True):
        recording = read(path)
        np.testing.assert_array_equal(recording.states, rollout.observations)
        np.testing.assert_array_equal(recording.inputs[:-1], rollout.inputs)
        assert not np.array_equal(rollout.observations, rollout.states)  # there is noise


@pytest.fixture
def run(tmp_path, monkeypatch) -> str:
    """A run folder of an agent that has learned as good as nothing."""
    preset = dataclasses.replace(PRESETS["default"], config=TINY)
    monkeypatch.setitem(PRESETS, "default", preset)
    path = str(tmp_path / "run")
    assert main(["train", "--trials", "1", "--quiet", "--out", path]) == 0
    return path


def test_a_learned_policy_can_be_recorded(tmp_path, run) -> None:
    assert record(tmp_path / "out", "--policy", run) == 0
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "policy-seed0-00.csv",
        "policy-seed0-01.csv",
    ]
    assert len(read(tmp_path / "out" / "policy-seed0-00.csv")) == 16


def test_a_policy_of_another_system_is_refused(tmp_path, run, capsys) -> None:
    other = ["--policy", run, "--env", "mcpilco/Pendulum-v0"]
    assert "leave --env out" in refused(capsys, "--out", str(tmp_path / "out"), *other)


def test_no_file_is_overwritten(tmp_path, capsys) -> None:
    (tmp_path / "excitation-seed0-01.csv").write_text("mine")
    assert "nothing is overwritten" in refused(capsys, "--out", str(tmp_path), *SHORT)
    assert [p.read_text() for p in tmp_path.iterdir()] == ["mine"]


INTERRUPTED = """
import gymnasium as gym
from envs.cartpole import CartPoleSwingUpEnv


class Interrupted(CartPoleSwingUpEnv):
    steps = 0

    def step(self, action):
        self.steps += 1
        if self.steps > 20:
            raise KeyboardInterrupt
        return super().step(action)


gym.register("Strange/Interrupted-v0", Interrupted)
"""


def test_an_interruption_keeps_what_is_there(tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.setattr("gymnasium.envs.registration.registry", dict(gym.registry))
    assert record("out", "--env", "interrupted:Strange/Interrupted-v0") == 130
    assert "1 of 2 recordings are saved in out" in capsys.readouterr().err
    assert len(read(tmp_path / "out" / "excitation-seed0-00.csv")) == 16


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--seconds", "0"], "--seconds must be positive"),
        (["--seconds", "nan"], "--seconds must be positive"),
        (["--dt", "-1"], "--dt must be positive"),
        (["--rollouts", "0"], "--rollouts must be at least 1"),
        (["--rollouts", "100000000"], "--rollouts must be at most 100000, got 100000000"),
        (["--seconds", "1e9"], "at most 10000000 steps of 0.1 s, got 1e+09 s for 6"),
        (["--seed", "-1"], "--seed must not be negative"),
        (["--seconds", "1"], "each rollout at least 10 steps of 0.1 s, got 1 s for 6"),
        (["--policy", "nothing"], "excitation or random or a run folder, got 'nothing'"),
        (["--env", "nowhere/Nothing-v0"], "Namespace nowhere not found"),
    ],
)
def test_wrong_arguments_are_refused_before_a_folder_is_made(
    tmp_path, capsys, arguments, sentence
) -> None:
    assert sentence in refused(capsys, "--out", str(tmp_path / "out"), *arguments)
    assert not (tmp_path / "out").exists()


def test_angles_of_a_recording_count_turns(task: TaskSpec) -> None:
    angle = np.linspace(0, 9, 40)
    observations = np.column_stack([angle, angle, (angle + np.pi) % (2 * np.pi) - np.pi, angle])
    rollout = Rollout(0.1, observations, np.zeros((39, 1)), np.zeros(39))
    recording = from_rollout("a", rollout, task)
    np.testing.assert_allclose(recording.states[:, 2], angle)
    np.testing.assert_array_equal(recording.states[:, 0], angle)
