"""Where MuJoCo's cart-pole is shown: in 3D as the analytic one, and in a picture."""

from __future__ import annotations

import os
import subprocess
import sys
from itertools import pairwise

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from envs.cartpole import CartPoleSwingUpEnv
from envs.mujoco_cartpole import MujocoCartPoleSwingUpEnv
from envs.mujoco_views import Posture, backends, scene
from envs.plants import cart_pole
from mcpilco.typing import EnvError
from tests.envs.systems import needs_gl

STATES = np.random.default_rng(0).normal(size=(20, 4)) * 3


def test_scene_is_that_of_the_analytic_cart_pole():
    ours = MujocoCartPoleSwingUpEnv(pole_length=0.8).scene
    theirs = CartPoleSwingUpEnv.scene_of(cart_pole().where(pole_length=0.8))
    marked = ours.marker(STATES) - theirs.marker(STATES)
    in_front = [0.0, ours.target[1], 0.0]  # of the cart, where the pole is drawn
    np.testing.assert_allclose(marked, np.tile(in_front, (20, 1)), atol=1e-12)
    np.testing.assert_allclose(np.subtract(ours.target, theirs.target), in_front, atol=1e-12)
    mine, yours = ours.poses(STATES), theirs.poses(STATES)
    np.testing.assert_allclose(mine["cart"].translation, yours["cart"].translation, atol=1e-12)
    for name, shape in theirs.shapes.items():
        assert ours.shapes[name].kind == shape.kind
        np.testing.assert_allclose(ours.shapes[name].color, shape.color, atol=1)


def test_pole_ends_at_the_tip():
    shown = MujocoCartPoleSwingUpEnv(pole_length=0.8).scene
    pose, (_, half) = shown.poses(STATES)["pole"], shown.shapes["pole"].size
    along = Rotation.from_quat(pose.quaternion).apply([0.0, 0.0, half])
    distances = [
        np.linalg.norm(pose.translation + end - shown.marker(STATES), axis=1)
        for end in (along, -along)
    ]
    np.testing.assert_allclose(np.minimum(*distances), 0.0, atol=1e-12)


def test_every_shape_has_a_pose():
    shown = MujocoCartPoleSwingUpEnv().scene
    poses = shown.poses(STATES)
    assert set(poses) == set(shown.shapes) == {"rail", "cart", "axle", "pole"}
    assert all(p.translation.shape == (20, 3) for p in poses.values())
    assert all(p.quaternion.shape == (20, 4) for p in poses.values())


def test_scene_shows_what_is_visible_and_simple_and_marks_the_mass_without_a_tip():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <asset><material name="red" rgba="1 0 0 1"/></asset>
          <worldbody>
            <geom type="plane" size="1 1 1"/>
            <body>
              <joint name="pole" axis="0 -1 0"/>
              <geom type="sphere" size="0.1" pos="0 0 -1" material="red"/>
              <geom name="hidden" type="sphere" size="0.2" rgba="1 1 1 0" mass="0"/>
              <geom name="collision" type="sphere" size="0.2" group="3" mass="0"/>
            </body>
          </worldbody>
        </mujoco>
    """)
    shown = scene(Posture(model, ("pole",), "tip"), np.array([np.pi, 0.0]))
    (shape,) = shown.shapes.values()
    assert (shape.kind, shape.size, shape.color) == ("sphere", (0.1,), (255, 0, 0))
    np.testing.assert_allclose(shown.marker(np.array([np.pi / 2, 0.0])), [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(shown.target, [0, 0, 1], atol=1e-12)


ORANGE, BLUE, RED = (214, 120, 46), (64, 84, 120), (190, 60, 70)


def pixels(image: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
    """Rows and columns of pixels whose color has these proportions, in whatever light."""
    rgb, wanted = image.astype(float), np.array(color, dtype=float)
    cosine = (rgb @ wanted) / (np.linalg.norm(rgb, axis=2) * np.linalg.norm(wanted) + 1e-9)
    return np.argwhere(cosine > 0.995)


@pytest.fixture(scope="module")
def picture():
    env = MujocoCartPoleSwingUpEnv(render_mode="rgb_array")
    yield env.picture
    env.close()


@needs_gl
def test_hanging_pole_is_drawn_below_the_cart_and_upright_pole_above(picture):
    rows = [pixels(picture(np.array([0, 0, q, 0])), ORANGE)[:, 0].mean() for q in (0.0, np.pi)]
    cart = pixels(picture(np.zeros(4)), BLUE)[:, 0].mean()
    assert rows[1] < cart < rows[0]


@needs_gl
def test_cart_moves_to_the_right_and_stays_in_the_picture_however_far_it_goes(picture):
    columns = [
        pixels(picture(np.array([q, 0.0, 0.0, 0.0])), BLUE)[:, 1].mean()
        for q in (-0.5, 0, 0.5, 3, 40)
    ]
    assert columns[0] < columns[1] < columns[2] < columns[3] < 640
    assert columns[4] == pytest.approx(columns[3], abs=1)


@needs_gl
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_force_is_drawn_to_its_side_and_as_long_as_it_is_strong(picture, side):
    still = picture(np.zeros(4)).astype(int)
    widths = []
    for strength in (0.4, 0.8):
        changed = (picture(np.zeros(4), side * strength) != still).any(axis=2)
        columns = np.flatnonzero(changed.any(axis=0)) - 319.5
        assert (side * columns > 0).all()
        widths.append(np.ptp(columns))
    assert widths[1] == pytest.approx(2 * widths[0], rel=0.15)


@needs_gl
def test_rendering_differs_from_frame_to_frame_and_can_go_on_after_close():
    env = MujocoCartPoleSwingUpEnv(render_mode="rgb_array")
    env.reset(seed=0)
    frames = [env.render()]
    for _ in range(5):
        env.step(np.array([5.0], dtype=np.float32))
        frames.append(env.render())
    assert all((a != b).any() for a, b in pairwise(frames))
    env.close()
    np.testing.assert_array_equal(env.render(), frames[-1])


VARIABLES = ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY")


@pytest.fixture
def environment(monkeypatch):
    """Sets the variables that decide."""

    def give(**values):
        for name in VARIABLES:
            monkeypatch.delenv(name, raising=False)
        for name, value in values.items():
            monkeypatch.setenv(name, value)

    monkeypatch.setattr(sys, "platform", "linux")
    return give


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, ["egl"]),
        ({"DISPLAY": ":0"}, ["egl", "glfw"]),
        ({"MUJOCO_GL": "osmesa", "DISPLAY": ":0"}, ["osmesa"]),
        ({"MUJOCO_GL": " GLFW "}, ["glfw"]),
        ({"MUJOCO_GL": "on"}, ["egl"]),
    ],
)
def test_egl_is_chosen_unless_another_way_is_asked_for(environment, values, expected):
    environment(**values)
    assert backends() == expected


@pytest.mark.slow
@needs_gl
def test_picture_needs_no_display_even_where_mujoco_was_imported_first():
    code = (
        "import mujoco, envs, gymnasium as gym;"
        "e = gym.make('mcpilco/MujocoCartPoleSwingUp-v0', render_mode='rgb_array');"
        "e.reset(seed=0); print(e.render().std() > 1)"
    )
    bare = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=bare)
    assert (done.returncode, done.stdout, done.stderr) == (0, "True\n", "")


def test_missing_opengl_is_told_with_what_to_install(environment, monkeypatch):
    environment()
    # None makes Python answer an import as it does where a module is missing
    monkeypatch.setitem(sys.modules, "mujoco.egl", None)
    env = MujocoCartPoleSwingUpEnv(render_mode="rgb_array")
    env.reset(seed=0)
    with pytest.raises(EnvError, match="egl says: .*apt-get install libegl1"):
        env.render()
