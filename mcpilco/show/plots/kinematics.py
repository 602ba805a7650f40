"""Pictures of a kinematic chain that was found, and of what its forward kinematics predicts."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mcpilco.identification.kinematics import KinematicChain, PoseErrors, Tolerance, scores
from mcpilco.recordings import MarkerRecording
from mcpilco.show.plots.style import MODEL, SYSTEM, add_legend, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_DPI = 110
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
    """
    left, right = new_axes(2)
    import matplotlib.pyplot as plt  # new_axes has said what to do where it is missing

    plot_triplets(recording, chain, tolerance, left)
    if errors is None:
        right.set_axis_off()
    else:
        plot_pose_errors(errors, right)
    plt.savefig(path, dpi=_DPI)
    plt.close()
    return path


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
    ax.set_xlabel("pair of markers")
    ax.set_ylabel("joint")
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
