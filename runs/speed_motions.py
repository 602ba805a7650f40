"""How many motions of a plant a core simulates in a second, beside MuJoCo: ratios in one process.

    python runs/speed_motions.py
    python runs/speed_motions.py --model arm.xml --motions 200

Motions of a second under random commands, on one thread. `together` is one call of the compiled
equations for all motions, which go side by side; `alone` a call for each. `mujoco.rollout` takes
the model as it is, with its integrator and timestep. An error is the largest one of the positions
in the median motion, against MuJoCo's Runge-Kutta steps of a tenth of that time.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import mujoco.rollout
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parent))

from harness import use_one_thread
from speed.measures import in_turns

from mcpilco.mjcf import plant_of

DT, T = 0.02, 50


@dataclass(frozen=True)
class Arguments:
    """The model, and how much of it is timed."""

    model: Path = Path(__file__).parent / "hidden_effects/rotary_pendulum.xml"
    """an MJCF of an open chain with motors"""
    motions: int = 400
    """of a second each"""
    repeats: int = 3
    """turns of each way, of three calls; the median counts"""


def main() -> int:
    use_one_thread()
    arguments = tyro.cli(Arguments, description=__doc__)
    plant, B = plant_of(arguments.model), arguments.motions
    rng, U = np.random.default_rng(0), len(plant.layout.inputs)
    start, commands = rng.normal(size=(B, len(plant.layout.states))), rng.normal(size=(B, T, U))

    def alone() -> np.ndarray:
        each = (slice(b, b + 1) for b in range(B))
        return np.concatenate([plant.simulate(start[b], commands[b], DT) for b in each])

    model = mujoco.MjModel.from_xml_path(str(arguments.model))
    ways: dict[str, Callable[[], np.ndarray]] = {
        "together": lambda: plant.simulate(start, commands, DT),
        "alone": alone,
        "mujoco.rollout": lambda: rolled_out(model, start, commands),
    }
    found = {name: way()[:, :, 0::2] for name, way in ways.items()}  # compiles
    fine = mujoco.MjModel.from_xml_path(str(arguments.model))
    fine.opt.timestep, fine.opt.integrator = (
        model.opt.timestep / 10.0,
        mujoco.mjtIntegrator.mjINT_RK4,
    )
    truth = rolled_out(fine, start, commands)[:, :, 0::2]
    seconds = [
        float(np.median(taken)) for taken in in_turns(list(ways.values()), arguments.repeats)
    ]
    print("way              motions [1/s]   of mujoco.rollout   error")
    for (name, positions), took in zip(found.items(), seconds, strict=True):
        error = np.median(np.abs(positions - truth).max(axis=(1, 2)))
        print(f"{name:14s} {B / took:15.0f} {seconds[-1] / took:19.2f} {error:9.1e}")
    return 0


def rolled_out(model: mujoco.MjModel, start: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """States (B, T + 1, X) as [q1, q1', q2, ...], by MuJoCo itself."""
    steps = round(DT / model.opt.timestep)
    whole = np.concatenate([np.zeros((len(start), 1)), start[:, 0::2], start[:, 1::2]], axis=1)
    data, held = mujoco.MjData(model), np.repeat(commands, steps, axis=1)
    states, _ = mujoco.rollout.rollout(model, data, whole, held)
    after = np.concatenate([whole[:, None], states[:, steps - 1 :: steps]], axis=1)[:, :, 1:]
    return np.stack([after[:, :, : model.nv], after[:, :, model.nv :]], axis=3).reshape(
        len(start), -1, 2 * model.nv
    )


if __name__ == "__main__":
    sys.exit(main())
