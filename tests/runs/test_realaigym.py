"""`runs/realaigym`: the regulator near the top, the switch to it, and our rows in the boards."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from realaigym.regulator import UPRIGHT, Regulator, Switched

from envs.plants import BOARD, PLANTS

DT = 0.002


def plant_of(robot: str):
    return PLANTS[f"mcpilco/{robot}-v0"]().where(**BOARD)


@pytest.mark.parametrize("robot", ["Pendubot", "Acrobot"])
def test_the_regulator_brings_what_it_may_be_trusted_with_to_the_top(robot):
    plant = plant_of(robot)
    regulator = Regulator(plant, DT, limit=6.0)
    normal = np.random.default_rng(0).normal(size=(20, 4))
    away = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    root = np.linalg.cholesky(np.linalg.inv(regulator.P))
    states = UPRIGHT + 0.7 * np.sqrt(regulator.level) * away @ root.T
    assert all(map(regulator.trusted, states))
    assert not regulator.trusted(np.zeros(4))
    for _ in range(1500):
        torques = np.array([[[regulator(state)]] for state in states])
        states = plant.simulate(states, torques, DT)[:, -1]
    assert np.abs(states - UPRIGHT).max() < 0.05


def test_a_turn_more_is_the_same_place():
    regulator = Regulator(plant_of("Pendubot"), DT, limit=6.0)
    state = UPRIGHT + np.array([0.01, 0.1, -0.02, 0.0])
    assert regulator(state - [2 * np.pi, 0.0, -2 * np.pi, 0.0]) == pytest.approx(regulator(state))


def test_the_policy_holds_its_torque_until_the_regulator_is_trusted_and_again_when_it_is_lost():
    regulator = Regulator(plant_of("Pendubot"), DT, limit=6.0)
    asked = []
    act = Switched(lambda state: asked.append(1) or float(len(asked)), regulator, every=3)
    hanging, top = np.zeros(4), UPRIGHT + np.array([0.001, 0.0, 0.0, 0.0])
    assert [act(hanging) for _ in range(4)] == [1.0, 1.0, 1.0, 2.0]
    assert act(top) == regulator(top)
    assert act(hanging) == 3.0
    act.reset()
    assert act(hanging) == 4.0


def test_the_plant_of_the_boards_is_an_env():
    for robot in ("Pendubot", "Acrobot"):
        env = gym.make(f"mcpilco/Board{robot}-v0")
        assert env.spec.max_episode_steps * env.unwrapped.task.dt == pytest.approx(10.0)
        assert env.unwrapped.plant.values["shoulder_friction"] == 0.0


def test_our_rows_stand_among_those_that_are_published(run, tmp_path):
    about = {"robot": "pendubot", "variant": "spread, regulator", "seed": 0, "experience_s": 7.5}
    about |= {"cpu_s": 50.0, "machine": {"cpu": "a processor", "cores": 2}, "robustness": 0.8}
    about |= {"score": {"RealAI Score": 0.5}, "shares": dict.fromkeys(run.SHARES, 0.8)}
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "one.json").write_text(json.dumps(about))
    run.write_readme(tmp_path)
    rows = [
        line
        for line in (tmp_path / "README.md").read_text().splitlines()
        if line.startswith("| ") and "0." in line
    ]
    names = [row.split("|")[1].strip() for row in rows[:6]]
    assert names[:3] == ["AR-EAPO", "**ours: spread, regulator, seed 0**", "evolSAC"]
