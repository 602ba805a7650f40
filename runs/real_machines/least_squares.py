"""Inverse-dynamics least squares of the EMPS recording, to compare the workflow's answers with.

    python runs/real_machines/least_squares.py --data FOLDER

Position and force are filtered without phase (Butterworth, 20 Hz), velocity and acceleration are
differences; samples slower than 5 mm/s do not count.
"""

from __future__ import annotations

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


@dataclass(frozen=True)
class Arguments:
    """Fit a mass and frictions to a drive."""

    data: Path
    """folder of the machines' folders"""


def main() -> None:
    arguments = tyro.cli(Arguments, description=__doc__)
    t, q, force = np.loadtxt(arguments.data / "emps/emps.csv", delimiter=",", skiprows=1).T
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
        found = np.linalg.lstsq(A, force[rows])[0]
        told = ", ".join(f"{term} = {value:.2f}" for term, value in zip(terms, found, strict=True))
        print(f"{name}: {told}; residual of {np.std(force[rows] - A @ found):.2f} N")


if __name__ == "__main__":
    main()
