"""`runs/realaigym`: regulator, observer, cost, polish, who acts, and our rows in the boards."""

from __future__ import annotations

import json
import sys
from types import ModuleType

import gymnasium as gym
import numpy as np
import pytest
import torch
from realaigym.equations import nominal_row, step
from realaigym.motion import HANGING, Gaussians, motion, upright
from realaigym.observer import Observer
from realaigym.polish import Loop, descended, kicked, moved, polished
from realaigym.regulator import UPRIGHT, Regulator, blended
from realaigym.score import cost
from realaigym.swing_cost import SwingCost

from envs.plants import BOARD, PLANTS
from mcpilco.agent import NumpyPolicy

pytestmark = pytest.mark.xdist_group("boards")  # one process compiles what all of them need

DT = 0.002


def plant_of(robot: str):
    return PLANTS[f"mcpilco/{robot}-v0"]().where(**BOARD)


ORDER = [0, 2, 1, 3]
"""where our states are among the boards'"""


@pytest.mark.slow
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


def written(path, weight: float):
    """A file of a policy as `write_policy` makes it, with random Gaussians."""
    rng = np.random.default_rng(3)
    arrays = {
        "centres": rng.normal(size=(20, 6)),
        "lengthscales": np.array([8.0, 8.0, 1.0, 1.0, 1.0, 1.0]),
        "weights": weight * rng.normal(size=(20, 1)),
        "middle": np.zeros(1),
        "half_range": np.array([6.0]),
        "angles": np.array([0, 2]),
        "squash": np.array(1.0),
    }
    np.savez(path, **arrays)
    return path


def test_a_compiled_policy_answers_as_the_exported_one(tmp_path):
    path = written(tmp_path / "policy.npz", 1.0)
    ours, exported = Gaussians.read(path), NumpyPolicy(path)
    for state in np.random.default_rng(4).normal(size=(10, 4)) * 3.0:
        assert ours(state) == pytest.approx(exported(state)[0])


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["pendubot", "acrobot"])
def test_a_compiled_motion_is_that_of_policy_regulator_and_plant(robot, tmp_path):
    plant, joint = plant_of(robot.capitalize()), ["pendubot", "acrobot"].index(robot)
    policy = Gaussians.read(written(tmp_path / "policy.npz", 1.0))
    regulator, row = Regulator(plant, DT, 6.0, 3.0), nominal_row(plant)
    state = np.array([2.9, 0.1, 0.5, -0.5])
    states, torques = motion(policy, regulator, row, joint, 50, state)
    for after, torque in zip(states[1:], torques, strict=True):
        assert torque == pytest.approx(blended(policy, regulator, state[ORDER]))
        state = step(state, *((torque, 0.0) if joint == 0 else (0.0, torque)), row, DT)
        np.testing.assert_allclose(after, state, atol=1e-9)


def test_a_policy_is_written_and_read_without_a_change(tmp_path):
    like = written(tmp_path / "policy.npz", 1.0)
    policy = Gaussians.read(like)
    policy.write(tmp_path / "again.npz", like)
    again, state = Gaussians.read(tmp_path / "again.npz"), np.array([1.0, -2.0, 3.0, 1.0])
    assert again(state) == pytest.approx(policy(state), rel=1e-12)
    other = moved(policy, np.full(20 + 120 + 6, 0.1))
    other.write(tmp_path / "other.npz", like)
    assert NumpyPolicy(tmp_path / "other.npz")(state)[0] == pytest.approx(other(state))
    assert abs(other(state) - policy(state)) > 1e-3


NEARLY_UP = (np.pi - 0.035, 0.14, 0.0, 0.0)
"""at the edge of the regulator's region, where policy and regulator share the torque"""


def loop_of(robot: str, start: tuple[float, ...] = HANGING, steps: int = 300) -> Loop:
    plant = plant_of(robot.capitalize())
    joint = ["pendubot", "acrobot"].index(robot)
    return Loop(Regulator(plant, DT, 6.0, 3.0), nominal_row(plant), joint, start, steps)


@pytest.mark.slow
@pytest.mark.parametrize("start", [HANGING, NEARLY_UP])
@pytest.mark.parametrize("robot", ["pendubot", "acrobot"])
def test_the_slopes_are_those_of_finite_differences(robot, start, tmp_path):
    policy = Gaussians.read(written(tmp_path / "policy.npz", 0.3))
    loop = loop_of(robot, start)
    share = loop.regulator(np.array(start)[ORDER])[0]
    assert share == 0.0 if start == HANGING else 0.1 < share < 0.9
    _, (weights, centres, scales) = loop.cost_and_slopes(policy)
    size = np.abs(policy.weights).mean()
    slopes, nudges = np.concatenate([size * weights, centres.ravel(), scales]), 1e-5 * np.eye(146)
    ends = [[loop.cost(moved(policy, side * n)) for side in (1, -1)] for n in nudges]
    differences = np.subtract(*np.transpose(ends)) / 2e-5
    assert np.abs(differences).max() > 1e-3
    np.testing.assert_allclose(slopes, differences, atol=1e-6 * np.abs(differences).max())


def test_the_cost_is_1_less_the_score_of_a_motion_that_ends_upright():
    """Half a second upright and still after one below, by the boards' definitions."""
    regulator = Regulator(plant_of("Pendubot"), DT, 6.0, 3.0)
    states = np.zeros((751, 4))
    states[500:, 0] = np.pi
    torques = np.zeros(750)
    torques[100:200] = 2.0  # squares: 0.8 N^2 m^2 s; jumps: 8 N^2 m^2 in 5000 steps
    parts = np.array([1.0, 0.0, 0.8, np.sqrt(8.0 / 5000), 0.0])
    score = 1.0 - np.tanh(np.pi * parts / [20.0, 60.0, 20.0, 0.1, 400.0]).mean()
    assert cost(states, torques, regulator, 0) == pytest.approx(1.0 - score, abs=2e-3)


@pytest.mark.slow
def test_polish_betters_the_score_in_the_model(tmp_path):
    policy, loop = Gaussians.read(written(tmp_path / "policy.npz", 0.3)), loop_of("pendubot")
    found = descended(policy, loop, 5)
    assert found.cost < loop.cost(policy)
    assert found.cost == loop.cost(found.policy)


@pytest.mark.slow
def test_a_kick_is_kept_only_where_it_betters_the_score(tmp_path, monkeypatch):
    """The best of policies and loops is kicked and polished; what comes back scores as it says."""
    from realaigym import polish

    for name, few in {"ROUGH": 3, "SHORT": 3, "FINE": 3, "KEPT": 1}.items():
        monkeypatch.setattr(polish, name, few)
    policies = [Gaussians.read(written(tmp_path / f"{w}.npz", w)) for w in (0.1, 0.3)]
    loop = loop_of("pendubot")
    rough = min((descended(policy, loop, 3) for policy in policies), key=lambda one: one.cost)
    assert kicked(rough, np.random.default_rng(0)).cost <= rough.cost
    best = polished(policies, [loop, loop_of("pendubot", NEARLY_UP)], np.random.default_rng(0))
    assert best.cost <= rough.cost
    assert best.loop.cost(best.policy) == best.cost


@pytest.mark.slow
def test_a_policy_is_upright_from_as_many_starts_as_its_region_has(tmp_path):
    """Without a torque all hang; nothing that swings comes to rest upright."""
    plant = plant_of("Acrobot")
    path = written(tmp_path / "policy.npz", 0.0)
    assert upright(path, Regulator(plant, DT, 6.0, 1e-6), nominal_row(plant), 1) == 0.0


def cost_of(**numbers):
    plant = plant_of("Acrobot")
    row, region = nominal_row(plant), Regulator(plant, DT, 6.0, 4.0)
    return SwingCost(row, region, 1, (1.5, 1.5, 1.5), **numbers)


def test_the_cost_is_least_upright_and_a_turn_more_is_the_same():
    cost = cost_of(near=0.4, energy=0.3)
    upright = torch.from_numpy(UPRIGHT)
    turn = torch.from_numpy(np.pi * np.array([2.0, 0.0, -2.0, 0.0]))
    torque, others = torch.zeros(1), torch.randn(50, 4, generator=torch.manual_seed(0)) * 3.0
    assert float(cost(upright, torque)) == pytest.approx(0.0, abs=1e-12)
    assert float(cost(upright + turn, torque)) == pytest.approx(0.0, abs=1e-12)
    assert (cost(others.double(), torch.zeros(50, 1)) > 0.01).all()


def test_the_energy_that_is_missing_is_kept_by_a_motion_without_torque():
    """It is -1 hanging and 0 upright; only a torque changes it."""
    lacking = cost_of()._lacking
    ends = torch.tensor([[0.0, 0.0, 0.0, 0.0], [np.pi, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(lacking(ends), [-1.0, 0.0], atol=1e-6)
    state, row = np.array([1.0, -2.0, 3.0, 1.0]), nominal_row(plant_of("Acrobot"))
    before = lacking(torch.from_numpy(state[ORDER]))
    for _ in range(500):
        state = step(state, 0.0, 0.0, row, DT)
    assert float(lacking(torch.from_numpy(state[ORDER])) - before) == pytest.approx(0.0, abs=1e-4)


@pytest.fixture
def controller(tmp_path, monkeypatch):
    """Of a thrifty and a robust policy; the boards' base class is theirs, so here is another."""
    base = ModuleType("double_pendulum.controller.abstract_controller")
    base.AbstractController = type("AbstractController", (), {"init": lambda self: self.init_()})
    monkeypatch.setitem(sys.modules, base.__name__, base)
    from realaigym.board import Controller

    robust, thrifty = (written(tmp_path / f"{w}.npz", w) for w in (1.0, -1.0))
    made = Controller("acrobot", robust, 6.0, 6.3, True, True, thrifty, 3.0)
    made.init()
    return made


@pytest.mark.parametrize("push", [0.0, 2.5])
def test_the_robust_policy_acts_from_where_the_plan_is_left(controller, push):
    state, row = np.zeros(4), nominal_row(plant_of("Acrobot"))
    for k in range(100):
        torque = controller.get_control_output_(state)[1]
        by = controller.thrifty if not push or k < 50 else controller.robust
        if k < 50 or k > 60:
            assert torque == pytest.approx(by(state[ORDER]), abs=0.2)
        state = step(state, 0.0, torque, row, DT)
        state[3] += push * (k == 50)
    assert (controller._step is None) == bool(push)


def test_the_plant_of_the_boards_is_an_env():
    for robot in ("Pendubot", "Acrobot"):
        env = gym.make(f"mcpilco/Board{robot}-v0")
        assert env.spec.max_episode_steps * env.unwrapped.task.dt == pytest.approx(10.0)
        assert env.unwrapped.plant.values["shoulder_friction"] == 0.0


def test_what_the_scripts_lack_is_told_before_a_policy_is_learned(run, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "NEEDED", ("json", "no_such_package"))
    monkeypatch.setattr(run, "learned", lambda *_: pytest.fail("a policy was learned"))
    monkeypatch.setattr("sys.argv", ["run.py", "--checkout", str(tmp_path), "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="need no_such_package"):
        run.main()


def test_a_folder_without_the_boards_is_told_before_a_policy_is_learned(run, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "NEEDED", ())
    monkeypatch.setattr(run, "learned", lambda *_: pytest.fail("a policy was learned"))
    monkeypatch.setenv("MCPILCO_BOARD", str(tmp_path))
    monkeypatch.setattr("sys.argv", ["run.py", "--out", str(tmp_path)])
    with pytest.raises(SystemExit, match="must be a clone of double_pendulum"):
        run.main()


def test_one_result_is_named_by_its_file(run):
    only = run.Arguments(only="pendubot-without-spread-0130")
    assert run.asked(only) == [("pendubot", "without spread", 130)]
    for name in ("pendubot-fool-0130", "pendubot-full"):
        with pytest.raises(SystemExit, match="--only must be such as"):
            run.asked(run.Arguments(only=name))
    assert run.asked(run.Arguments(seeds="3:5")) == [("pendubot", "full", s) for s in (3, 4)]


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
