"""MuJoCo moves as the plant does, with the forces that were learned on it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest

from mcpilco.mjcf.corrected import passive_forces, write_corrected_mjcf
from mcpilco.mjcf.models import plant_of
from mcpilco.plant.correction import Correction
from mcpilco.plant.effects.learned import Axis, LearnedForce
from mcpilco.typing import InputError

XML = """
<mujoco>
  <option timestep="0.001" integrator="RK4"/>
  <worldbody>
    <body>
      <joint name="hinge" axis="0 -1 0" damping="0.05"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.02" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="hinge" gear="2" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
GRIDS = (
    (Axis("hinge_position", -2.0, 2.0, 12), Axis("hinge_velocity", -8.0, 8.0, 10, slow=0.3)),
    (Axis("motor", -2.0, 2.0, 8),),
)


@pytest.fixture
def path(tmp_path: Path) -> Iterator[Path]:
    file = tmp_path / "lift.xml"
    file.write_text(XML)
    yield file
    mujoco.set_mjcb_passive(None)


def learned() -> list[LearnedForce]:
    rng = np.random.default_rng(0)
    sizes = [int(np.prod([axis.knots for axis in axes])) for axes in GRIDS]
    return [
        LearnedForce("hinge", axes, tuple(rng.normal(0.0, 0.3, size)))
        for axes, size in zip(GRIDS, sizes, strict=True)
    ]


@pytest.mark.slow
def test_mujoco_with_the_callback_moves_as_the_plant(path: Path) -> None:
    plant = plant_of(path).with_learned(learned())
    start, commands = np.array([[0.4, 1.0]]), np.repeat([0.3, -2.0, 0.7], 10)
    told = plant.simulate(start, commands[None, :, None], 0.01)[0, :, 0]
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    data.qpos[0], data.qvel[0] = start[0]
    moved = {}
    for callback in (None, passive_forces(model, learned())):
        mujoco.mj_resetData(model, data)
        data.qpos[0], data.qvel[0] = start[0]
        mujoco.set_mjcb_passive(callback)
        angles = [data.qpos[0].copy()]
        for command in commands:
            data.ctrl[0] = command
            mujoco.mj_step(model, data, 10)
            angles.append(data.qpos[0].copy())
        moved[callback is None] = np.array(angles)
    np.testing.assert_allclose(moved[False], told, atol=1e-5)
    assert np.abs(moved[True] - told).max() > 0.01


def test_mjcf_cannot_say_a_learned_force_and_says_so(path: Path, tmp_path: Path) -> None:
    correction = Correction("lift", {}, (), tuple(learned()[:1]))
    (sentence,) = write_corrected_mjcf(path, correction, tmp_path / "corrected.xml")
    assert sentence.startswith(
        "MJCF cannot say the learned force (hinge; over hinge_position and hinge_velocity); let"
    )


def test_a_force_of_another_model_gets_a_sentence(path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(path))
    with pytest.raises(InputError, match="no joint, state or input 'elbow'; it has hinge,"):
        passive_forces(model, [LearnedForce("elbow", GRIDS[1], (0.0,) * 8)])
