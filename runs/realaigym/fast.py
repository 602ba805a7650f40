"""Runs a script of the checkout with the equations of its plant compiled.

Called as `fast.py SCRIPT ARGUMENTS`; `double_pendulum` is the checkout's. The script and what it
simulates stay as they are: `DoublePendulumPlant.rhs` gives the same numbers in a twentieth of the
time (`tests/runs/test_realaigym.py` compares the equations).
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
from double_pendulum.model.plant import DoublePendulumPlant
from realaigym.equations import Row, slope


def row_of(plant: DoublePendulumPlant) -> Row:
    """Its numbers; inertias are about the joints."""
    (m1, m2), (r1, r2) = plant.m, plant.com
    places = (m1 * r1, m2 * r2, m2, plant.l[0], *plant.I, plant.g)
    return np.array([*places, *plant.b, *plant.coulomb_fric, plant.Ir, plant.gr], dtype=float)


def rhs(self: Any, t: float, state: Any, tau: Any) -> Any:
    """Velocities and accelerations, as theirs returns them."""
    if not hasattr(self, "compiled_row"):
        self.compiled_row = row_of(self)
    motors = self.B @ tau
    return slope(state, motors[0], motors[1], self.compiled_row)


if __name__ == "__main__":
    DoublePendulumPlant.rhs = rhs
    sys.argv = sys.argv[1:]
    sys.path.insert(0, str(Path(sys.argv[0]).parent))  # as Python does
    runpy.run_path(sys.argv[0], run_name="__main__")
