"""A drive in a closed loop at 1 kHz, behind a fine encoder: simulated, not by code of ours."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mcpilco.gap.data import GapProblem
from mcpilco.gap.fit import fit_model
from mcpilco.mjcf import plant_of
from mcpilco.plant import Plant
from mcpilco.recordings import Recording, misreadings, read_for_plant

MASS, VISCOUS, COULOMB, OFFSET = 90.0, 180.0, 22.0, -4.0
ENCODER_M = 2e-6
XML = f"""
<mujoco model="drive">
  <worldbody>
    <body name="slide">
      <joint name="slide" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="{MASS}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="force" joint="slide" ctrlrange="-300 300"/></actuator>
</mujoco>
"""


def driven(seed: int, seconds: float = 16.0, ms: int = 4) -> np.ndarray:
    """Rows of time, position and force: a controller follows smooth steps of position.

    Semi-implicit Euler at a quarter of a millisecond; the friction sticks.
    """
    rng = np.random.default_rng(seed)
    goals = np.append(0.0, rng.uniform(-0.12, 0.12, int(seconds) + 1))
    q = v = force = 0.0
    rows, h = [], 1e-3 / ms
    for k in range(round(seconds * 1e3)):
        t = 1e-3 * k
        part = t % 1.0
        blend = 0.5 - 0.5 * np.cos(np.pi * min(part / 0.7, 1.0))
        goal = goals[int(t)] + (goals[int(t) + 1] - goals[int(t)]) * blend
        seen = ENCODER_M * np.round(q / ENCODER_M)
        force = 2.5e4 * (goal - seen) - 2.2e3 * v
        rows.append((t, seen, force))
        for _ in range(ms):
            free = v + h * (force + OFFSET - VISCOUS * v) / MASS
            brake = h * COULOMB / MASS
            v = np.sign(free) * max(abs(free) - brake, 0.0)
            q += h * v
    return np.array(rows)


def problem(tmp_path: Path, dt: float) -> tuple[Plant, list[Recording]]:
    (tmp_path / "drive.xml").write_text(XML)
    plant = plant_of(tmp_path / "drive.xml")
    path = tmp_path / "log.csv"
    header = ",".join(("time", plant.layout.states[0], plant.layout.inputs[0]))
    np.savetxt(path, driven(0), delimiter=",", header=header, comments="", fmt="%.9g")
    return plant, read_for_plant(plant, [path], dt=dt)[0]


def test_a_model_that_is_far_off_a_fine_encoder_is_fitted_all_the_same(tmp_path: Path) -> None:
    """The nominal plant misses by ten thousand noise std; that is no simulation that ran away."""
    plant, recordings = problem(tmp_path, 0.02)
    gap = GapProblem.of(plant, recordings, 0.01, (), {})
    windows = gap.windows()
    model = gap.model(windows)
    friction = next(c for c in plant.candidates() if c.effect.name == "viscous_friction")
    nominal = fit_model(model, windows, np.zeros(model.nuisances), windows.guess)
    grown, theta = model.grown(np.zeros(model.nuisances), friction, [20.0])
    assert np.sqrt(np.median(nominal.by_window / windows.samples)) > 1e3
    assert fit_model(grown, windows, theta, windows.guess).chi2 < 0.3 * nominal.chi2


def test_a_drive_that_spends_its_force_on_friction_is_no_other_machine(tmp_path: Path) -> None:
    assert misreadings(*problem(tmp_path, 0.005)) == ()
