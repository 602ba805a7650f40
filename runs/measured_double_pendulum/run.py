"""What `mcpilco gap` finds in recordings of a real double pendulum.

    python runs/measured_double_pendulum/run.py --data FOLDER

FOLDER holds the two recordings that README.md names. The nominal plant has the masses, centers and
inertias of the authors' model without friction; masses and inertias are free. README.md is
rewritten between its marked lines.
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

from envs.plants import double_pendulum
from mcpilco.gap import Gap, investigate
from mcpilco.plant import Plant
from mcpilco.recordings import Recording, read_recordings

HERE = Path(__file__).parent
NAMES = "double_chirp_both", "double_chirp_both_c"
COLUMNS = {
    "time": "time_s",
    "shoulder_angle": "position1_rad",
    "shoulder_velocity": "velocity1_rad_s",
    "elbow_angle": "position2_rad",
    "elbow_velocity": "velocity2_rad_s",
    "shoulder_torque": "torque1_measured_nm",
    "elbow_torque": "torque2_measured_nm",
}
FREE = "upper_mass", "upper_inertia", "lower_mass", "lower_inertia"
"""with these the plant has every inertia and weight that such a chain can have"""


@dataclass(frozen=True)
class Published:
    """The authors' model 1.1 of their design C.1: two links, no friction, no motor's inertia."""

    lengths: tuple[float, float] = (0.2, 0.3)
    """[m]"""
    masses: tuple[float, float] = (0.5234602302310271, 0.6255677234174437)
    """[kg]"""
    centers: tuple[float, float] = (0.2, 0.25569305436052964)
    """from the joint [m]"""
    inertias: tuple[float, float] = (0.031887199591513114, 0.05086984812807257)
    """about the joint [kg m^2]"""
    gravity: float = 9.81
    """[m/s^2]"""


@dataclass(frozen=True)
class Arguments:
    """Look for what is missing in the model of a real double pendulum."""

    data: Path
    """folder of the recordings"""
    dt: float = 0.02
    """sampling time to which they are brought [s]"""
    held_out: str = NAMES[1]
    """the recording that no fit may see"""
    out: Path = HERE
    """folder of README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    started = time.process_time()
    gap = find(arguments.data, arguments.dt, arguments.held_out)
    seconds = time.process_time() - started
    parts = [effects_table(gap), errors_table(gap), steps_table(gap), events_table(gap)]
    parts.append(f"{seconds:.0f} CPU seconds, on one thread.")
    fill(arguments.out / "README.md", parts, template=HERE / "README.md")
    print("\n\n".join(parts))
    return 0


def find(data: Path, dt: float = 0.02, held_out: str = NAMES[1]) -> Gap:
    """The published double pendulum without friction, inertias and weights free."""
    return investigate(nominal(), recordings(data, dt), free=FREE, held_out=(held_out,))


def nominal(published: Published = Published()) -> Plant:
    """The authors' model as a plant."""
    values = {
        "shoulder_friction": 0.0,
        "elbow_friction": 0.0,
        "gravity": published.gravity,
    }
    for number, link in enumerate(("upper", "lower")):
        mass, length = published.masses[number], published.lengths[number]
        center = published.centers[number]
        about_center = published.inertias[number] - mass * center**2
        values |= {
            f"{link}_mass": mass,
            f"{link}_length": length,
            f"{link}_center": center / length,
            f"{link}_inertia": about_center / (mass * length**2),
        }
    return double_pendulum().where(**values)


def recordings(data: Path, dt: float) -> list[Recording]:
    """Both, on one grid."""
    layout = double_pendulum().layout
    good, bad = read_recordings(
        [data / f"{name}.csv" for name in NAMES],
        layout.states,
        layout.inputs,
        angles=(0, 2),
        velocities=((0, 1), (2, 3)),
        columns=COLUMNS,
        dt=dt,
    )
    if bad:
        raise bad[0]
    return good


if __name__ == "__main__":
    sys.exit(main())
