"""Five real machines: their nominal plants, their recordings, and what is held out of these."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from envs.plants import PLANTS, double_pendulum
from mcpilco.mjcf import plant_of
from mcpilco.plant import Plant
from mcpilco.recordings import Recording, read_for_plant

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Machine:
    """A machine, and the questions that its recordings are asked."""

    plant: Callable[[], Plant]
    """nominal"""
    folder: str
    """of its recordings, in that of all data"""
    held_out: Mapping[str, tuple[str, ...]]
    """the recordings that no fit may see, by the name of the question"""
    files: tuple[str, ...] = ()
    """stems; none: all that are there"""
    columns: Mapping[str, str] = field(default_factory=dict)
    """of time, states and inputs in the files"""
    free: tuple[str, ...] = ()
    """parameters of which nothing is known"""
    parts: int = 1
    """into which each file is cut"""
    dts_ms: tuple[float, ...] = (20.0,)
    """sampling times at which motions are compared [ms]"""
    repeated: str = ""
    """name of the question that is asked again with parts left out; by default the first"""

    def recordings(self, data: Path, dt: float) -> list[Recording]:
        """All of them, on one grid.

        Args:
            data: folder of the machines' folders.
            dt: sampling time [s].
        """
        paths = sorted((data / self.folder).glob("*.csv"))
        chosen = [path for path in paths if not self.files or path.stem in self.files]
        with tempfile.TemporaryDirectory() as folder:
            cut = [part for path in chosen for part in self._cut(path, Path(folder))]
            return read_for_plant(self.plant(), cut, {"*": dict(self.columns)}, dt)[0]

    def _cut(self, path: Path, folder: Path) -> Sequence[Path]:
        """A file, or the files of its parts, one after the other in time."""
        if self.parts == 1:
            return [path]
        header, *rows = path.read_text().splitlines()
        found = []
        for number, part in enumerate(np.array_split(np.arange(len(rows)), self.parts), start=1):
            found.append(folder / f"{path.stem}_{number}.csv")
            found[-1].write_text("\n".join([header, *(rows[k] for k in part)]))
        return found


def dfki_pendulum() -> Plant:
    """A pendulum without friction, whose mass and length are not known."""
    return PLANTS["mcpilco/Pendulum-v0"]().where(friction=0.0)


def dfki_double_pendulum() -> Plant:
    """The authors' model 1.1 of their design C.1: two links, no friction, no motor's inertia."""
    values = {"shoulder_friction": 0.0, "elbow_friction": 0.0, "gravity": 9.81}
    links = {
        "upper": (0.2, 0.5234602302310271, 0.2, 0.031887199591513114),
        "lower": (0.3, 0.6255677234174437, 0.25569305436052964, 0.05086984812807257),
    }
    for link, (length, mass, center, about_joint) in links.items():
        values |= {
            f"{link}_mass": mass,
            f"{link}_length": length,
            f"{link}_center": center / length,
            f"{link}_inertia": (about_joint - mass * center**2) / (mass * length**2),
        }
    return double_pendulum().where(**values)


def _mjcf(name: str) -> Callable[[], Plant]:
    return lambda: plant_of(HERE / f"{name}.xml")


def _chirps(*numbers: str) -> tuple[str, ...]:
    return tuple(f"chirp_{number}" for number in numbers)


MACHINES = {
    "emps": Machine(
        _mjcf("emps"),
        "emps",
        {f"third {k}": (f"emps_{k}",) for k in (3, 2, 1)},
        parts=3,
        dts_ms=(20.0, 10.0, 5.0, 2.5, 1.0),
    ),
    "quanser_cart_pole": Machine(
        _mjcf("quanser_cart_pole"),
        "quanser_cart_pole",
        {
            "swing-ups": ("swingup_1", "swingup_2"),
            "chirps": _chirps("plus_1", "plus_2", "plus_3", "minus_1", "minus_2"),
        },
        columns={"pole_position": "pole_angle"},
        repeated="chirps",
    ),
    "quanser_qube": Machine(
        _mjcf("quanser_qube"),
        "quanser_qube",
        {
            "swing-ups": ("swingup_1", "swingup_2", "swingup_3"),
            "chirps": _chirps("plus_1", "plus_2", "minus_1", "minus_2"),
        },
        repeated="chirps",
    ),
    "dfki_pendulum": Machine(
        dfki_pendulum,
        "dfki_pendulum",
        {name: (f"pendulum_{name}",) for name in ("release", "energy", "ddp", "dircol")},
        columns={
            "time": "time_s",
            "angle": "position_rad",
            "velocity": "velocity_rad_s",
            "torque": "torque_measured_nm",
        },
        free=("mass", "length"),
    ),
    "dfki_double_pendulum": Machine(
        dfki_double_pendulum,
        "dfki_double_pendulum",
        {"second": ("double_chirp_both_c",), "first": ("double_chirp_both",)},
        columns={
            "time": "time_s",
            "shoulder_angle": "position1_rad",
            "shoulder_velocity": "velocity1_rad_s",
            "elbow_angle": "position2_rad",
            "elbow_velocity": "velocity2_rad_s",
            "shoulder_torque": "torque1_measured_nm",
            "elbow_torque": "torque2_measured_nm",
        },
        free=("upper_mass", "upper_inertia", "lower_mass", "lower_inertia"),
    ),
}
"""by name"""
