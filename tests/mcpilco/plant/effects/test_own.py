"""A user's own effect is searched, written, read again and simulated, and never run unasked."""

from __future__ import annotations

import json

import gymnasium as gym
import mujoco
import numpy as np
import pytest

import envs
from mcpilco.mjcf import plant_of, write_corrected_mjcf
from mcpilco.plant import (
    Addition,
    Correction,
    EffectInstance,
    correction_of,
    own_effects,
    read_correction,
    write_correction,
)
from mcpilco.plant.effects import CATALOGUE
from mcpilco.plant.equations.step import beyond_equations
from mcpilco.plant.simulation.laws import code_of, force_of
from mcpilco.plant.simulation.motion import simulate
from mcpilco.typing import InputError
from tests.mcpilco.mjcf.test_corrected import ROBOT
from tests.mcpilco.plant.equations.test_step import errors
from tests.mcpilco.plant.simulation.reference import pendulum_motion

PENDULUM = "mcpilco/Pendulum-v0"
FILE = '''
from mcpilco.plant import JointForce, Symbol, exp, larger


class CubicDrag(JointForce):
    """-c v^3."""

    name = "cubic_drag"
    symbols = (Symbol("c", "{f} s^3/{q}^3", low=0.0),)

    @staticmethod
    def force(q, v, c):
        return -c * v * v * v


class OneWayBrake(JointForce):
    """-b exp(-q^2) v where v > 0."""

    name = "one_way_brake"
    symbols = (Symbol("b", "{f} s/{q}", low=0.0),)

    @staticmethod
    def force(q, v, b):
        return -b * exp(-1.0 * q * q) * larger(v, 0.0)
'''


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "my_effects.py"
    path.write_text(FILE)
    return path


def machine(file, value=0.02):
    cubic, _ = own_effects(file)
    return envs.PLANTS[PENDULUM]().having([(EffectInstance(cubic, "pendulum"), (value,))])


def test_an_own_effect_moves_a_plant_as_scipy_says(file):
    start, torque = np.array([0.4, 1.0]), np.repeat([2.0, -1.5, 0.5], 5)
    truth = pendulum_motion(start, torque, 0.02, law=lambda q, v: -0.02 * v**3)
    found = machine(file).simulate(start[None], torque[None, :, None], 0.02)[0]
    np.testing.assert_allclose(found, [truth.at(0.02 * k) for k in range(16)], rtol=0.0, atol=5e-5)


def test_own_effects_stand_beside_the_catalogue(file):
    plant = envs.PLANTS[PENDULUM]().knowing(own_effects(file))
    assert list(plant.catalogue) == [*CATALOGUE, "cubic_drag", "one_way_brake"]
    names = [candidate.effect.name for candidate in plant.candidates()]
    assert names[-2:] == ["cubic_drag", "one_way_brake"]
    assert type(own_effects(file)[0]) is type(own_effects(str(file))[0])


def test_an_own_effect_is_a_part_of_a_models_equations(file):
    cubic, brake = own_effects([file])
    plant = envs.PLANTS["mcpilco/CartPoleSwingUp-v0"]()
    plant = plant.having([(EffectInstance(e, "cart"), (0.02,)) for e in (cubic, brake)])
    assert errors(plant).max() < 1e-4
    assert beyond_equations(plant) == ()


def test_a_correction_names_the_file_and_does_not_execute_it(file, tmp_path):
    nominal = envs.PLANTS[PENDULUM]()
    correction = correction_of(machine(file), nominal)
    path = write_correction(tmp_path / "corrected.json", correction)
    (written,) = json.loads(path.read_text())["effects"]
    assert written == {
        "name": "cubic_drag",
        "target": "pendulum",
        "parameters": {"c": 0.02},
        "file": "my_effects.py",
    }
    assert read_correction(path, effects=file) == correction
    file.write_text("raise RuntimeError('executed')")
    with pytest.raises(InputError, match=r"effects='my_effects.py'\)"):
        read_correction(path)
    with pytest.raises(InputError, match="a user's own, of the file 'my_effects.py'"):
        gym.make(PENDULUM, effects=str(path))
    with pytest.raises(InputError, match="my_effects.py fails: RuntimeError: executed"):
        read_correction(path, effects=file)


def test_an_env_simulates_an_own_effect(file):
    def states(effects):
        env = gym.make(PENDULUM, effects=effects, noise_std=0.0)
        env.reset(seed=0)
        return np.array([env.step(np.array([4.0], np.float32))[0] for _ in range(20)])

    nominal = envs.PLANTS[PENDULUM]()
    found = states(correction_of(machine(file), nominal))
    assert np.abs(found - states(correction_of(machine(file, 0.0), nominal))).max() > 0.05


def test_mjcf_says_a_cubic_drag_and_refuses_what_it_cannot_by_name(file, tmp_path):
    cubic, brake = own_effects(file)
    source, path = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(ROBOT)
    additions = (
        Addition("cubic_drag", "elbow", {"c": 0.3}, cubic),
        Addition("one_way_brake", "elbow", {"b": 0.1}, brake),
    )
    (sentence,) = write_corrected_mjcf(source, Correction("robot", {}, additions), path)
    assert sentence.startswith("MJCF cannot say one_way_brake (elbow; b = 0.1); add its force")
    model = mujoco.MjModel.from_xml_path(str(path))
    np.testing.assert_allclose(model.dof_dampingpoly[2], [0.0, 0.3])
    assert plant_of(source).layout.joints[2] == "elbow"


def own(body: str, base: str = "JointForce", name: str = '"mine"', doc: str = '"""-a v."""') -> str:
    return f"""
from mcpilco.plant import JointForce, Symbol
from mcpilco.plant.effects.actuator import ActuatorEffect

class Mine({base}):
    {doc}
    name = {name}
    symbols = (Symbol("a", "{{f}}"),)
    column = 0
    def probes(self, scale):
        return []
    @staticmethod
    def force(q, v, a):
        {body}
"""


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x = 1", "must have a class of an effect, got none"),
        ("x = ", "fails: SyntaxError"),
        (own("return -a * v", base="ActuatorEffect"), "Mine must be a force in a joint"),
        (own("return -a * v", name='"spring"'), "has the name 'spring' of the catalogue"),
        (own("return -a * v", doc=""), "Mine must have its formula as its docstring"),
        (own("return 1.0 - a * v"), "Mine must give no force at the neutral values"),
        (own("return open(a)"), "numba cannot compile the force of mine"),
    ],
)
def test_a_file_that_is_of_no_use_gets_a_sentence(tmp_path, text, sentence):
    path = tmp_path / "mine.py"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        own_effects(path)


def test_a_missing_file_gets_a_sentence(tmp_path):
    with pytest.raises(InputError, match="Cannot read"):
        own_effects(tmp_path / "nowhere.py")


def test_a_formula_that_asks_for_more_than_arithmetic_is_left_out_of_equations_by_name(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(own("return -a * v if v > 0 else 0.0"))
    (mine,) = own_effects(path)
    plant = envs.PLANTS[PENDULUM]().having([(EffectInstance(mine, "pendulum"), (0.1,))])
    assert np.isfinite(plant.simulate(np.ones((1, 2)), np.zeros((1, 5, 1)), 0.02)).all()
    assert beyond_equations(plant) == ("mine",)


def test_an_unknown_law_is_refused_by_name():
    plant = envs.PLANTS[PENDULUM]()
    tables = plant.tables(plant.nominal[None])
    unknown = tables._replace(law=np.array([99]))
    with pytest.raises(InputError, match="there is no law 99 of a joint"):
        simulate(
            unknown,
            np.zeros(1, int),
            np.zeros((1, 2)),
            np.zeros(1, int),
            np.zeros((1, 3, 1)),
            0,
            0.02,
        )
    for effect in plant.catalogue.values():
        if hasattr(effect, "force"):
            assert force_of(code_of(effect)) is effect
