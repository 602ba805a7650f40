"""Which MuJoCo models are a cart-pole, and what is said of those that are not."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from envs.mujoco_cartpole_model import BUILT_IN, build_model, input_limit, read_model
from envs.plants import cart_pole
from mcpilco.typing import InputError


@pytest.fixture
def changed(tmp_path):
    """The path of the built-in model with pieces of its text replaced."""

    def change(*pieces: tuple[str, str]):
        text = BUILT_IN.read_text()
        for old, new in pieces:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path = tmp_path / "mine.xml"
        path.write_text(text)
        return path

    return change


def test_built_in_file_says_pilcos_constants_itself():
    """So that a copy of it, and a tool that reads it, begin with them."""
    read, built = read_model(BUILT_IN), build_model(cart_pole())
    for name in ("body_mass", "body_ipos", "dof_damping", "geom_size", "geom_pos", "site_pos"):
        np.testing.assert_allclose(getattr(read, name), getattr(built, name), err_msg=name)
    np.testing.assert_allclose(read.body_inertia, built.body_inertia, atol=1e-8)
    np.testing.assert_array_equal(read.opt.gravity, [0, 0, -9.82])
    assert read.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert input_limit(read) == 10.0


def test_path_that_holds_no_model_is_refused(tmp_path, monkeypatch, unchecked_shapes):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "no.xml").write_text("mass: 3")
    (tmp_path / "other.xml").write_text("<svg/>")
    (tmp_path / "notes.txt").write_text("mass: 3")
    (tmp_path / "short.xml").write_text("<mujoco><worldbody>")
    (tmp_path / "wrong.xml").write_text('<mujoco><option timestep="soon"/></mujoco>')
    for name in ("no.xml", "other.xml", "notes.txt", "short.xml", "wrong.xml"):
        with pytest.raises(InputError, match=f"{name} is no model that MuJoCo can load") as error:
            read_model(tmp_path / name)
        assert str(error.value).endswith(".")
    for missing in (tmp_path / "missing.xml", str(tmp_path)):
        with pytest.raises(
            InputError, match="model must be an MJCF file, got .*, which is no file"
        ):
            read_model(missing)
    with pytest.raises(InputError, match="must be the path"):
        read_model(3)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


MOTOR = '<motor name="force" joint="cart" ctrlrange="-10 10"/>'
LAGGED = '<general name="force" joint="cart" dyntype="filter" dynprm="0.1"/>'
CART, POLE = '<joint name="cart"', '<joint name="pole"'
IN_NEWTON = "must be the force on the cart in N"


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        (
            [(CART, '<joint name="wagon"'), (MOTOR, MOTOR.replace("cart", "wagon"))],
            'no joint "cart"; the slide joint',
        ),
        ([(POLE, "<joint")], 'no joint "pole"; the hinge joint'),
        ([('type="hinge"', 'type="slide"')], '"pole" must be of type hinge, got slide'),
        (
            [(POLE, f'<joint name="twist" axis="0 0 1"/>{POLE}')],
            "only, got cart, twist, pole",
        ),
        ([(MOTOR, MOTOR.replace("force", "push"))], 'no actuator "force"; add <motor'),
        ([(MOTOR, MOTOR + '<motor joint="pole"/>')], 'no actuator but "force", got 2'),
        ([(MOTOR, MOTOR.replace("cart", "pole"))], "must act on the joint"),
        ([(MOTOR, MOTOR.replace("/>", ' gear="5"/>'))], IN_NEWTON),
        ([(MOTOR, '<position name="force" joint="cart"/>')], IN_NEWTON),
        ([(MOTOR, LAGGED)], IN_NEWTON),
        ([('<body name="pole">', '<body name="pole" euler="0 3.14 0">')], "hang at the angle 0"),
    ],
)
def test_model_that_is_no_cart_pole_is_refused(changed, pieces, says):
    path = changed(*pieces)
    with pytest.raises(InputError) as error:
        read_model(path)
    message = str(error.value)
    assert says in message
    assert str(path) in message
    assert message.endswith(f"{BUILT_IN} is a model to begin with.")


@pytest.mark.parametrize("limits", ["", 'ctrlrange="-10 5"', 'ctrlrange="0 10"'])
def test_force_without_a_limit_equal_on_both_sides_is_asked_for(changed, limits):
    path = changed(('ctrlrange="-10 10"', limits))
    with pytest.raises(InputError, match="force_limit must be given"):
        input_limit(read_model(path))
