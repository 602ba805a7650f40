"""`runs/realaigym`: the regulator near the top, the observer, and our rows in the boards."""

from __future__ import annotations

import json

import gymnasium as gym
import numpy as np
import pytest
from realaigym.equations import nominal_row, step
from realaigym.observer import Observer
from realaigym.regulator import UPRIGHT, Regulator, blended

from envs.plants import BOARD, PLANTS

DT = 0.002


def plant_of(robot: str):
    return PLANTS[f"mcpilco/{robot}-v0"]().where(**BOARD)


ORDER = [0, 2, 1, 3]
"""where our states are among the boards'"""


@pytest.mark.parametrize("robot", ["Pendubot", "Acrobot"])
def test_the_regulator_brings_its_region_to_the_top_where_no_torque_is_cut_off(robot):
    plant = plant_of(robot)
    regulator = Regulator(plant, DT, limit=6.0, room=1.0)
    normal = np.random.default_rng(0).normal(size=(20, 4))
    away = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    root = np.linalg.cholesky(np.linalg.inv(regulator.P))
    states = UPRIGHT + 0.7 * np.sqrt(regulator.level) * away @ root.T
    assert all(0.0 < regulator(state)[0] < 1.0 for state in states)
    assert regulator(np.zeros(4))[0] == 0.0
    for _ in range(1500):
        torques = np.array([[[regulator(state)[1]]] for state in states])
        states = plant.simulate(states, torques, DT)[:, -1]
    assert np.abs(states - UPRIGHT).max() < 0.05


def test_a_turn_more_is_the_same_place():
    regulator = Regulator(plant_of("Pendubot"), DT, limit=6.0)
    state = UPRIGHT + np.array([0.01, 0.1, -0.02, 0.0])
    turned = state - [2 * np.pi, 0.0, -2 * np.pi, 0.0]
    assert regulator(turned) == pytest.approx(regulator(state))


def test_the_torque_goes_from_the_policy_to_the_regulator_without_a_jump():
    regulator = Regulator(plant_of("Pendubot"), DT, limit=6.0)
    on_the_way = UPRIGHT + np.linspace(0.0, 1.0, 2001)[:, None] * [0.0, 0.0, 0.0, 6.0]
    torques = [blended(lambda state: 6.0, regulator, state) for state in on_the_way]
    assert torques[0] == 0.0
    assert torques[-1] == blended(lambda state: 6.0, None, UPRIGHT) == 6.0
    assert np.abs(np.diff(torques)).max() < 0.1


@pytest.mark.parametrize("robot", ["Pendubot", "Acrobot"])
def test_the_equations_are_those_of_our_plant(robot):
    plant, rng = plant_of(robot), np.random.default_rng(1)
    states, torques = rng.normal(size=(20, 4)) * [2.0, 2.0, 5.0, 5.0], rng.normal(size=20) * 3.0
    theirs = plant.simulate(states[:, ORDER], torques[:, None, None], DT)[:, -1]
    for state, torque, after in zip(states, torques, theirs, strict=True):
        both = (torque, 0.0) if robot == "Pendubot" else (0.0, torque)
        ours = step(state, *both, nominal_row(plant), DT)
        np.testing.assert_allclose(ours[ORDER], after, rtol=0, atol=1e-6)


@pytest.mark.parametrize("late", [0, 1, 15])
def test_the_observer_finds_the_delay_and_tells_the_state_now(late):
    """Velocities are measured with noise; positions late, but exactly."""
    row, rng = nominal_row(plant_of("Pendubot")), np.random.default_rng(2)
    observer, states = Observer(row, 0, DT), [np.zeros(4)]
    for k in range(400):
        measured = states[max(k - late, 0)] + rng.normal(size=4) * [0.0, 0.0, 0.5, 0.5]
        told = observer(measured)
        if k > 60:
            assert np.abs(told - states[k]).max() < 1e-3
        torque = 3.0 + 2.0 * np.sin(0.05 * k)
        observer.told(torque)
        states.append(step(states[-1], torque, 0.0, row, DT))
    assert observer.delay == late


def test_the_plant_of_the_boards_is_an_env():
    for robot in ("Pendubot", "Acrobot"):
        env = gym.make(f"mcpilco/Board{robot}-v0")
        assert env.spec.max_episode_steps * env.unwrapped.task.dt == pytest.approx(10.0)
        assert env.unwrapped.plant.values["shoulder_friction"] == 0.0


def test_our_means_stand_among_the_rows_that_are_published(run, tmp_path):
    about = {"robot": "pendubot", "variant": "full", "experience_s": 8.0, "cpu_s": 50.0}
    about |= {"machine": {"cpu": "a processor", "cores": 2}}
    about |= {"shares": dict.fromkeys(run.SHARES, 0.8)}
    (tmp_path / "results").mkdir()
    for seed, robust in enumerate((0.7, 0.9)):
        one = {"seed": seed, "robustness": robust, "score": {"RealAI Score": robust}}
        (tmp_path / "results" / f"{seed}.json").write_text(json.dumps(about | one))
    run.write_readme(tmp_path)
    rows = [line.split("|") for line in (tmp_path / "README.md").read_text().splitlines()]
    rows = [[cell.strip() for cell in row[1:-1]] for row in rows if len(row) == 8]
    assert [row[0] for row in rows[2:5]] == ["AR-EAPO", "**ours, full**", "evolSAC"]
    assert rows[3][1:] == ["0.800", "0.800", "8", "50", "2"]
