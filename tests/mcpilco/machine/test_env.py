"""Episodes on the rig: what it does arrives, and each of its faults is told and left behind."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import envs
from mcpilco.machine import MACHINE, MachineSettings, machine_of, meeting
from mcpilco.machine import env as machine_env
from mcpilco.recordings import read_for_plant
from mcpilco.typing import EnvError, InputError
from tests.mcpilco.rigs import Rig, rig

CART_POLE = "mcpilco/CartPoleSwingUp-v0"
PATIENT = {"watchdog": 2.0, "silence": 2.0}
"""on a machine that others use too"""


@pytest.fixture(scope="module")
def running() -> Iterator[Rig]:
    """One rig for all tests that leave it whole."""
    with rig() as made:
        yield made


@pytest.fixture
def met(running: Rig, tmp_path: Path) -> Iterator[Rig]:
    """A rig without faults, whose address was typed."""
    running.tell("spikes 0")
    with meeting(running.address, log=tmp_path / "log"):
        yield running


def machine(**keywords: Any) -> gym.Env:
    return gym.make(MACHINE, simulation=CART_POLE, **{**PATIENT, **keywords})


def push(env: gym.Env, steps: int, force: float = 0.5) -> list[tuple]:
    return [env.step(np.array([force])) for _ in range(steps)]


def test_no_env_is_a_machine_where_no_address_was_typed() -> None:
    with pytest.raises(EnvError, match="an address that you type"):
        gym.make(MACHINE, simulation=CART_POLE)


def test_an_episode_moves_and_is_logged_as_a_recording_of_the_plant(met: Rig, tmp_path) -> None:
    with contextlib.closing(machine(dt=0.05)) as env:
        first, info = env.reset()
        assert np.abs(first).max() < 0.1
        assert info["is_success"] is False
        moved = push(env, 12, 2.0)
        assert moved[-1][0][0] > 0.1
        assert moved[-1][4]["machine"]["ticks"] > 50
        env.reset()
    plant = envs.plant_named("--sim", CART_POLE)
    log = tmp_path / "log" / "episode-0000.csv"
    recordings, _ = read_for_plant(plant, [log])
    assert recordings[0].inputs.max() == pytest.approx(2.0)
    # The file itself: read onto even steps, rows are masked wherever a busy host let the rig wait.
    rows = np.loadtxt(log, delimiter=",", skiprows=1)
    assert rows[-1, 1] == pytest.approx(moved[-1][0][0], abs=0.1)
    seen = np.isfinite(recordings[0].states[:, 0])
    there = np.interp(recordings[0].time[seen], rows[:, 0], rows[:, 1])
    np.testing.assert_allclose(recordings[0].states[seen, 0], there, atol=0.1)


def test_what_a_program_has_frozen_stays_so(met: Rig) -> None:
    before = gc.get_freeze_count()
    assert before > 0, "the tests freeze what they import"
    with contextlib.closing(machine()) as env:
        env.reset()
        push(env, 1)
    assert gc.get_freeze_count() >= before


def test_the_rewards_are_those_of_the_simulation(met: Rig) -> None:
    with contextlib.closing(machine()) as env:
        env.reset()
        observed, reward, *_ = push(env, 1)[0]
        expected = envs.CartPoleSwingUpEnv().swing_up.reward(observed, np.array([0.5]))
        assert reward == pytest.approx(float(expected), abs=1e-2)


def test_a_state_beyond_its_limit_ends_the_episode_with_the_machine_safe(met: Rig) -> None:
    with contextlib.closing(machine(dt=0.05, limits={"cart_position": (-0.2, 0.2)})) as env:
        env.reset()
        while not (step := push(env, 1, 8.0)[0])[2]:
            pass
        assert "cart_position" in step[4]["fault"]
        with pytest.raises(gym.error.ResetNeeded):
            push(env, 1)
        assert abs(env.reset()[0][0]) < 0.1
        push(env, 2)


def faulty(met: Rig, tell: str, sentence: str, **settings: Any) -> None:
    """The fault is told, the machine is safe, and the next episode goes on."""
    with contextlib.closing(machine(dt=0.05, **settings)) as env:
        env.reset()
        push(env, 2)
        met.tell(tell)
        with pytest.raises(EnvError, match=sentence):
            push(env, 60)
        env.reset()
        push(env, 2)


def test_an_encoder_that_jumps_ends_the_episode(met: Rig) -> None:
    faulty(met, "jump 1.5", "sensor jumped", silence=0.5)


def test_a_machine_that_is_silent_ends_the_episode(met: Rig) -> None:
    faulty(met, "mute 1.0", "silent for 0.5 s", silence=0.5)


def test_false_angles_are_refused_and_counted(met: Rig) -> None:
    met.tell("spikes 0.2")
    with contextlib.closing(machine(dt=0.05)) as env:
        env.reset()
        steps = push(env, 20)
        assert max(abs(observed[2]) for observed, *_ in steps) < 0.5
        assert steps[-1][4]["machine"]["jumps"] > 0


@pytest.mark.slow
def test_a_learner_that_is_late_finds_the_machine_safe(met: Rig) -> None:
    with contextlib.closing(machine(watchdog=0.3)) as env:
        env.reset()
        push(env, 1)
        time.sleep(0.6)
        with pytest.raises(EnvError, match=r"watchdog's 0\.3 s"):
            push(env, 5)
        env.reset()
        push(env, 1)


@pytest.mark.slow
def test_a_rig_that_was_killed_is_told_and_another_one_is_met(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(machine_env, "PATIENCE_S", 0.8)
    with (
        rig() as first,
        meeting(first.address),
        contextlib.closing(machine(dt=0.05, silence=0.5)) as env,
    ):
        env.reset()
        push(env, 1)
        first.kill()
        with pytest.raises(EnvError, match="silent"):
            push(env, 60)
        with pytest.raises(EnvError, match="No machine answers"):
            env.reset()
        with rig(port=int(first.address.rpartition(":")[2])):
            env.reset()
            push(env, 2)


@pytest.mark.slow
def test_a_loop_that_was_killed_is_told_and_another_one_begins(met: Rig) -> None:
    with contextlib.closing(machine()) as env:
        env.reset()
        process = machine_env._met.process
        process.kill()
        with pytest.raises(EnvError, match="has ended"):
            push(env, 60)
        env.reset()
        push(env, 1)


def test_a_stop_by_hand_interrupts_and_is_no_fault_that_is_tried_again(met: Rig) -> None:
    with contextlib.closing(machine()) as env:
        env.reset()
        push(env, 1)
        os.kill(machine_env._met.process.pid, signal.SIGINT)
        with pytest.raises(KeyboardInterrupt, match="stopped by hand"):
            push(env, 60)


@pytest.mark.slow
def test_the_key_must_be_the_machines(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(machine_env, "PATIENCE_S", 0.8)
    key = tmp_path / "key"
    key.write_text("secret\n")
    with rig("--key", "secret") as made:
        with meeting(made.address, key=key), contextlib.closing(machine()) as env:
            env.reset()
        unsigned, silent = meeting(made.address), pytest.raises(EnvError, match="No machine")
        with unsigned, contextlib.closing(machine()) as env, silent:
            env.reset()


@pytest.mark.parametrize(
    ("keywords", "sentence"),
    [
        ({"rate": 15.0}, "a multiple of 10 Hz"),
        ({"rate": -1.0}, "rate of a machine must be a positive number"),
        ({"limits": {"speed": (0, 1)}}, "must name measured states"),
        ({"limits": {"cart_position": (1, 0)}}, "pairs"),
    ],
)
def test_settings_that_cannot_be_meant_are_refused(keywords: dict, sentence: str) -> None:
    with meeting("udp://127.0.0.1:1"), pytest.raises(InputError, match=sentence):
        machine(**keywords)


def test_the_keywords_of_a_machine_name_its_simulation_and_no_address() -> None:
    name, kwargs = machine_of(CART_POLE, {"dt": 0.05}, {"rate": 200})
    assert name == MACHINE
    assert kwargs == {
        "simulation": CART_POLE,
        "max_episode_steps": 30,
        "rate": 200,
        "dt": 0.05,
    }
    assert "address" not in MachineSettings.__dataclass_fields__
