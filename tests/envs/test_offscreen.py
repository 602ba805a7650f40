"""How a way to draw without a window is found, and what is said where there is none."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from envs.mujoco_cartpole import MujocoCartPoleSwingUpEnv
from envs.offscreen import backends
from mcpilco.typing import EnvError
from tests.envs.systems import needs_gl

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
