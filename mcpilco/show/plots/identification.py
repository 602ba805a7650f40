"""Plots of what was identified of a robot: its kinematics, its torques, its Volterra series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mcpilco.identification.kinematics import KinematicChain, PoseErrors, Tolerance, scores
from mcpilco.recordings import MarkerRecording
from mcpilco.show.plots.style import MODEL, PARTICLES, SYSTEM, add_legend, new_axes, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_LOWEST, _HIGHEST = 0.1, 10.0
"""scores between which the colours change; 1 is the tolerance [-]"""


def draw_kinematics(
    path: Path,
    recording: MarkerRecording,
    chain: KinematicChain,
    errors: PoseErrors | None,
    tolerance: Tolerance,
) -> Path:
    """Write both pictures as one PNG.

    Raises:
        InputError: matplotlib is missing.
        RunFolderError: the file cannot be written.
    """
    left, right = new_axes(2)
    plot_triplets(recording, chain, tolerance, left)
    if errors is None:
        right.set_axis_off()
    else:
        plot_pose_errors(errors, right)
    return write_picture(path, left)


def plot_triplets(
    recording: MarkerRecording, chain: KinematicChain, tolerance: Tolerance, ax: Axes | None = None
) -> Axes:
    """Residuals of all pairs of markers and all joints, in parts of the tolerance.

    The chain's own triplets are marked: H for a hinge, S for a slide.
    """
    from matplotlib.colors import LogNorm

    ax = ax or new_axes()[0]
    slides, turns = scores(chain.tests, tolerance)
    shown = np.minimum(slides, turns).T
    image = ax.imshow(
        shown, cmap="RdBu_r", norm=LogNorm(_LOWEST, _HIGHEST), aspect="auto", origin="upper"
    )
    names = recording.marker_names
    ax.set_xticks(
        range(shown.shape[1]),
        [f"{names[i]} {names[j]}" for i, j in chain.tests.pairs],
        rotation=90,
        fontsize="x-small",
    )
    ax.set_yticks(range(shown.shape[0]), recording.joint_names, fontsize="small")
    for first, joint in zip(chain.markers, chain.joints, strict=False):
        pair = sorted(map(names.index, (first, joint.marker)))
        column = int(np.flatnonzero((chain.tests.pairs == pair).all(1))[0])
        row = recording.joint_names.index(joint.name)
        letter = joint.kind[0].upper()
        ax.text(column, row, letter, color="white", ha="center", va="center", weight="bold")
    ax.set(xlabel="pair of markers", ylabel="joint")
    ax.figure.colorbar(image, ax=ax, label="residual / tolerance [-]")
    return ax


def plot_pose_errors(errors: PoseErrors, ax: Axes | None = None) -> Axes:
    """How large errors of position and orientation are: the share of frames below each size."""
    ax = ax or new_axes()[0]
    share = (np.arange(len(errors.time)) + 1) / len(errors.time)
    distance = np.sort(np.linalg.norm(errors.position, axis=1))
    ax.plot(1e3 * distance, share, color=MODEL, label="position [mm]")
    ax.plot(1e3 * np.sort(errors.angle), share, color=SYSTEM, label="orientation [mrad]")
    ax.set_xscale("log")
    ax.set_xlabel("error of the forward kinematics [mm], [mrad]")
    ax.set_ylabel("share of frames below [-]")
    add_legend(ax)
    return ax


def plot_torque(
    measured: Float[np.ndarray, " N"],
    predicted: Float[np.ndarray, " N"],
    name: str,
    unit: str,
    std: Float[np.ndarray, " N"] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """A joint's torque over the samples, measured in black and predicted in blue.

    With `std` the prediction has a band of two standard deviations.
    """
    ax = new_axes()[0] if ax is None else ax
    n = np.arange(len(measured))
    ax.plot(n, measured, color=SYSTEM, linewidth=2.5, alpha=0.4, label="measured")
    ax.plot(n, predicted, color=MODEL, linewidth=1.0, label="model")
    if std is not None:
        low, high = predicted - 2 * std, predicted + 2 * std
        ax.fill_between(n, low, high, color=MODEL, alpha=0.25, linewidth=0)
    ax.set(xlabel="held-out sample", ylabel=f"{name} [{unit}]")
    add_legend(ax)
    return ax


_INTERVAL = 1.96
"""95 % of a normal distribution lie within so many standard deviations"""


def plot_lags(values: Float[np.ndarray, "D D"], title: str = "", ax: Axes | None = None) -> Axes:
    """Magnitudes over two lags, the largest black, as figure 6.2 of the thesis has them.

    Only magnitudes relative to the largest are seen.
    """
    ax = new_axes()[0] if ax is None else ax
    size = np.abs(values)
    ax.imshow(size / max(float(size.max()), 1e-300), cmap="Greys", vmin=0.0, vmax=1.0)
    ax.set(xlabel="lag [samples]", ylabel="lag [samples]", title=title)
    return ax


def plot_response(
    h: Float[np.ndarray, " D"], dt: float | None = None, ax: Axes | None = None
) -> Axes:
    """The linear map h_1 over its lags.

    Without the sampling time `dt` [s] the axis counts samples.
    """
    ax = new_axes()[0] if ax is None else ax
    ax.plot((dt or 1.0) * np.arange(len(h)), h, ".-", color=MODEL)
    ax.axhline(0.0, color=PARTICLES, linewidth=0.5)
    ax.set(xlabel="lag [s]" if dt else "lag [samples]", ylabel="h_1 [output/input]")
    return ax


def plot_prediction(
    measured: Float[np.ndarray, " T"],
    mean: Float[np.ndarray, " T"],
    std: Float[np.ndarray, " T"],
    name: str,
    ax: Axes | None = None,
) -> Axes:
    """Draw a measured series and a model's prediction of it with its 95 % interval.

    The noise of the measurement is part of `std`.
    """
    ax = new_axes()[0] if ax is None else ax
    k = np.arange(len(mean))
    low, high = mean - _INTERVAL * std, mean + _INTERVAL * std
    ax.fill_between(k, low, high, color=PARTICLES, alpha=0.4, linewidth=0, label="95 %")
    ax.plot(k, measured, color=SYSTEM, linewidth=0.8, label="measured")
    ax.plot(k, mean, color=MODEL, linewidth=1.0, label="predicted")
    ax.set(xlabel="time [samples]", ylabel=name)
    add_legend(ax)
    return ax
