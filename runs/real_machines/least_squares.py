"""Inverse-dynamics least squares of two machines, to compare the workflow's answers with.

    python runs/real_machines/least_squares.py --data FOLDER

Position and force are filtered without phase (Butterworth, 20 Hz), velocity and acceleration are
differences; samples slower than 5 mm/s do not count. At the cart-pole the filter ends at 10 Hz, and
friction turns over within `TURN`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from scipy.signal import butter, filtfilt

MODELS = {
    "with an offset": ("M", "F_v", "F_c", "offset"),
    "with |v|": ("M", "F_v", "F_c", "F_|v|"),
    "with both": ("M", "F_v", "F_c", "offset", "F_|v|"),
}

CART, POLE, CENTER = 0.5, 0.127, 0.16825
"""masses of the cart-pole [kg], and the distance of the pole's center from its hinge [m]"""
TURN = 5e-3
"""speed within which a dry friction turns over [m/s]"""


@dataclass(frozen=True)
class Arguments:
    """Fit a mass and frictions to a drive, and a gain and frictions to a cart."""

    data: Path
    """folder of the machines' folders"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    emps(arguments.data / "emps/emps.csv")
    for path in sorted((arguments.data / "quanser_cart_pole").glob("*.csv")):
        cart_pole(path)


def emps(path: Path) -> None:
    """The mass and the frictions of the drive."""
    t, q, force = np.loadtxt(path, delimiter=",", skiprows=1).T
    dt = float(np.median(np.diff(t)))
    low_pass = butter(4, 20.0, fs=1.0 / dt)
    q, force = filtfilt(*low_pass, q), filtfilt(*low_pass, force)
    v = np.gradient(q, dt)
    columns = {
        "M": np.gradient(v, dt),
        "F_v": v,
        "F_c": np.sign(v),
        "offset": np.ones_like(v),
        "F_|v|": np.abs(v),
    }
    rows = np.flatnonzero(np.abs(v) > 5e-3)[200:-200:5]
    for name, terms in MODELS.items():
        A = np.stack([columns[term][rows] for term in terms], axis=1)
        print(f"{name}: {_fitted(A, force[rows], terms)} N")


def cart_pole(path: Path) -> None:
    """Newtons a volt, and the frictions of the cart, with the masses and the length as stated."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    dt = float(np.median(np.diff(table["time"])))
    low_pass = butter(2, 10.0, fs=1.0 / dt)
    volts = filtfilt(*low_pass, table["voltage"])
    x, angle = (filtfilt(*low_pass, np.unwrap(table[n])) for n in ("cart_position", "pole_angle"))
    v, w = np.gradient(x, dt), np.gradient(angle, dt)
    pull = np.cos(angle) * np.gradient(w, dt) - np.sin(angle) * w**2
    force = (CART + POLE) * np.gradient(v, dt) + POLE * CENTER * pull
    A = np.stack([volts, -v, -np.tanh(v / TURN), np.ones_like(v)], axis=1)
    told = _fitted(A[100:-100], force[100:-100], ("N a volt", "F_v", "F_c", "offset"))
    print(f"{path.stem}: {told} N")


def _fitted(A: np.ndarray, force: np.ndarray, terms: Sequence[str]) -> str:
    found = np.linalg.lstsq(A, force)[0]
    told = ", ".join(f"{term} = {value:.2f}" for term, value in zip(terms, found, strict=True))
    return f"{told}; residual of {np.std(force - A @ found):.2f}"


if __name__ == "__main__":
    main()
