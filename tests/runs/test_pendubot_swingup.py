from __future__ import annotations

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from harness import BEGIN, END, hasty
from pendubot_swingup.regulated_agent import ENVS, LIMIT
from realaigym.regulator import UPRIGHT

import envs
from envs.double_pendulum import PENDUBOT
from mcpilco.policies import riccati

pytestmark = pytest.mark.xdist_group("boards")  # one process compiles what all of them need


def trial(success: bool, p: float, seconds: float) -> dict:
    return {"success": success, "p": p, "experience_s": seconds, "time_up_s": 1.1, "cpu_s": 2.0}


def result(seed: int, *trials: dict, over: bool = True) -> dict:
    machine = {"cpu": "a processor", "cores": 2}
    about = {"robot": "pendubot", "variant": "full", "seed": seed, "machine": machine}
    return {**about, "over": over, "trials": list(trials)}


def slopes_of(plant, dt: float) -> tuple[np.ndarray, np.ndarray]:
    """A and B of a plant's step about upright, by central differences of its simulation."""
    steps = 1e-4 * np.concatenate([np.eye(5), -np.eye(5)])
    after = plant.simulate(UPRIGHT + steps[:, :4], steps[:, None, 4:], dt)[:, -1]
    slopes = (after[:5] - after[5:]) / 2e-4
    return slopes[:4].T, slopes[4:].T


def gain_of(plant, setting) -> np.ndarray:
    """The gain of a plant's regulator."""
    Q = np.diag(np.tile(setting.units or (1.0, 1.0), 2) ** -2.0)
    return riccati(*slopes_of(plant, setting.dt), Q, np.array([[LIMIT**-2.0]]))[0]


def test_last_policy_is_learned_from_60_s(run):
    for setting in run.SETTINGS.values():
        assert run.TRIALS * setting.steps * setting.dt == pytest.approx(60.0)


@pytest.mark.parametrize("robot", ["pendubot", "acrobot"])
def test_regulator_counts_each_state_in_the_unit_of_the_setting(run, robot):
    setting, plant = run.SETTINGS[robot], envs.PLANTS[ENVS[robot]]()
    config = hasty(run.config_of(robot, 0, setting))
    regulator = run.agent_of(robot, 0, setting, config).policy.regulator
    regulator.hold(*slopes_of(plant, setting.dt), np.zeros(1))
    gain = regulator.gain.numpy()
    assert gain == pytest.approx(gain_of(plant, setting), rel=1e-6)
    # at the edge of its region it asks for so many times the torque that there is
    farthest = np.linalg.solve(regulator.value.numpy(), gain[0])
    farthest *= np.sqrt(float(regulator.level) / (gain[0] @ farthest))
    assert gain[0] @ farthest == pytest.approx(setting.room * LIMIT)


def share_held(plant, gain: np.ndarray, dt: float) -> float:
    """Share of 200 motions from upright, sensed with noise, that stay within 10 degrees for 2 s."""
    noise, rng = np.array(PENDUBOT.noise_std), np.random.default_rng(0)
    states, held = np.tile(UPRIGHT, (200, 1)), np.ones(200, dtype=bool)
    for _ in range(round(2.0 / dt)):
        errors = states - UPRIGHT + noise * rng.normal(size=states.shape)
        torques = np.clip(-errors @ gain.T, -LIMIT, LIMIT)
        states = plant.simulate(states, torques[:, None], dt)[:, -1]
        held &= (np.abs(states - UPRIGHT)[:, ::2] < np.radians(10.0)).all(1)
    return float(held.mean())


def test_sensors_let_a_regulator_hold_the_acrobot_with_torques_for_10_ms_but_not_25(run):
    setting, plant = run.SETTINGS["acrobot"], envs.PLANTS[ENVS["acrobot"]]()
    assert share_held(plant, gain_of(plant, setting), setting.dt) > 0.95
    slow = replace(setting, dt=0.025)
    plain = replace(slow, units=(1.0, 1.0))
    for worse in (slow, plain):
        assert share_held(plant, gain_of(plant, worse), worse.dt) < run.SOLVED


@pytest.mark.parametrize("robot", ["pendubot", "acrobot"])
def test_physics_know_masses_that_are_wrong_by_up_to_a_fifth(run, robot):
    true = envs.PLANTS[f"mcpilco/{robot.capitalize()}-v0"]().values
    errors = []
    for seed in range(30):
        told = run.config_of(robot, seed, run.SETTINGS[robot]).model.plant["parameters"]
        errors.append([told[name] / true[name] - 1.0 for name in run.MASSES])
    assert np.abs(errors).max() <= run.WRONG
    assert np.abs(errors).max(0).min() > 0.8 * run.WRONG


def test_without_equations_the_agent_is_told_no_plant(run):
    setting = replace(run.SETTINGS["pendubot"], **run.VARIANTS["without equations"])
    config = hasty(run.config_of("pendubot", 0, setting))
    agent = run.agent_of("pendubot", 0, setting, config)
    assert (config.model.mean, config.model.plant) == ("zero", None)
    assert agent.task.cost == PENDUBOT.cost
    assert (agent.policy.regulator.room, agent.policy.regulator.trust) == (6.0, 0.5)


@pytest.mark.slow
def test_the_agent_learns_the_plant_of_its_regulator_and_its_cost(run):
    """After a search both are of the masses that were fitted, closer than the nominal ones."""
    setting = run.SETTINGS["pendubot"]
    config = replace(hasty(run.config_of("pendubot", 1, setting)), horizon=50)
    setting = replace(setting, sight=10 * setting.dt)
    agent = run.agent_of("pendubot", 0, setting, config)
    agent.learn(agent.timesteps_of(2))
    assert agent.policy.regulator.acts
    masses = {}, run.wrong_masses("pendubot", 1)
    true, nominal = (
        gain_of(envs.PLANTS["mcpilco/Pendubot-v0"]().where(**m), setting) for m in masses
    )
    learned = agent.policy.regulator.gain.numpy()
    assert np.abs(learned - true).max() < 0.2 * np.abs(nominal - true).max()
    values = envs.PLANTS["mcpilco/Pendubot-v0"]().values
    assert agent.task.cost.now.plant[2] == pytest.approx(values["lower_mass"], rel=0.05)
    setting = replace(setting, **run.VARIANTS["without regulator"])
    config = replace(config, policy=replace(config.policy, regulator=setting.room))
    plain = run.agent_of("pendubot", 0, setting, config)
    plain.learn(plain.timesteps_of(1))
    assert plain.policy.regulator is None


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pendubot", "acrobot"])
def test_quick_learns_a_seed_and_goes_on(page_of_two, robot, tmp_path):
    page = page_of_two("--robots", robot)
    found = json.loads((tmp_path / "results" / f"{robot}-full-0000.json").read_text())
    assert found["over"]
    assert [row["experience_s"] for row in found["trials"]] == [2.5, 5.0]
    assert f"| {robot} | full | 0 | 2 |" in page


@pytest.mark.slow
def test_a_seed_that_is_not_over_is_trained_again(run, tmp_path, monkeypatch):
    path = tmp_path / "results" / "pendubot-full-0000.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(result(0, trial(False, 0.0, 2.5), over=False)))
    called = []
    ended = result(0, trial(True, 1.0, 2.5))
    monkeypatch.setattr(run, "learned", lambda *a: called.append(a) or iter([ended]))
    monkeypatch.setattr(sys, "argv", ["run.py", "--seeds", "0:1", "--out", str(tmp_path)])
    assert run.main() == run.main() == 0
    assert len(called) == 1


def test_table_counts_seeds_that_succeeded_and_were_solved_of_all_that_were_begun(run):
    seeds = [
        result(0, trial(False, 0.2, 2.5), trial(True, 0.5, 5.0), trial(True, 0.9, 7.5)),
        result(1, trial(True, 0.4, 2.5), trial(False, 0.95, 5.0)),
        result(2, trial(False, 0.0, 2.5)),
        result(3, trial(False, 0.3, 2.5), over=False),
    ]
    (row,) = [line for line in run.table(seeds).split("\n") if "| full |" in line]
    robot, _, count, succeeded, solved, seconds, *_ = [cell.strip() for cell in row.split("|")[1:]]
    assert (robot, count) == ("pendubot", "4")
    assert succeeded.startswith("50.0")
    assert solved.startswith("25.0")
    assert seconds == "7.5 (7.5–7.5)"


def test_page_names_every_variant_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    assert all(f"*{name}*" in text.split(BEGIN)[0] for name in run.VARIANTS if name != "full")
