"""What `mcpilco gap` finds in recordings of a real pendulum.

    python runs/measured_pendulum/run.py --data FOLDER

FOLDER holds the four recordings that README.md names. Mass and length are free, so that inertia and
gravity are; nothing is told of the pushes by hand that some recordings hold. README.md is rewritten
between its marked lines.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro

sys.path.append(str(Path(__file__).parents[1]))  # what runs share, wherever it is run from

from gap_tables import effects_table, errors_table, events_table, steps_table
from harness import fill, use_one_thread

from envs.plants import PLANTS
from mcpilco.gap import Gap, investigate
from mcpilco.recordings import Recording, read_recordings

HERE = Path(__file__).parent
NAMES = "dircol", "energy", "ddp", "release"
COLUMNS = {
    "time": "time_s",
    "angle": "position_rad",
    "velocity": "velocity_rad_s",
    "torque": "torque_measured_nm",
}


@dataclass(frozen=True)
class Arguments:
    """Look for what is missing in the model of a real pendulum."""

    data: Path
    """folder of the recordings"""
    dt: float = 0.02
    """sampling time to which they are brought [s]"""
    out: Path = HERE
    """folder of README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    started = time.process_time()
    gap = find(arguments.data, arguments.dt)
    seconds = time.process_time() - started
    parts = [effects_table(gap), errors_table(gap), steps_table(gap), events_table(gap)]
    parts.append(f"{seconds:.0f} CPU seconds, on one thread.")
    fill(arguments.out / "README.md", parts, template=HERE / "README.md")
    print("\n\n".join(parts))
    return 0


def find(data: Path, dt: float) -> Gap:
    """The pendulum without friction, mass and length free, beside the recordings."""
    plant = PLANTS["mcpilco/Pendulum-v0"]().where(friction=0.0)
    return investigate(plant, recordings(data, dt), free=("mass", "length"))


def recordings(data: Path, dt: float) -> list[Recording]:
    """All four, on one grid."""
    layout = PLANTS["mcpilco/Pendulum-v0"]().layout
    good, bad = read_recordings(
        [data / f"pendulum_{name}.csv" for name in NAMES],
        layout.states,
        layout.inputs,
        angles=(0,),
        velocities=((0, 1),),
        columns=COLUMNS,
        dt=dt,
    )
    if bad:
        raise bad[0]
    return good


if __name__ == "__main__":
    sys.exit(main())
