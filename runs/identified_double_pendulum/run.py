"""Parameters of a real double pendulum from its recordings, beside its authors'.

    python runs/identified_double_pendulum/run.py --data FOLDER

FOLDER holds the folder dfki_double_pendulum of the two recordings that README.md names. Each is
fitted once, and what was found is judged on the other one. README.md is rewritten between its
marked lines.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import tyro
from jaxtyping import Float

sys.path.append(str(Path(__file__).parents[1]))  # its modules, wherever it is run from

from harness import fill, use_one_thread
from identified_double_pendulum import judge
from identified_double_pendulum.free_runs import fit_free_runs
from identified_double_pendulum.motion import KEPT, Motion, low_passed
from real_machines.machines import MACHINES

from mcpilco import identification
from mcpilco.identification import Moments, RigidBody, Rows, base_parameters, check_links, project
from mcpilco.sweep import markdown

HERE = Path(__file__).parent
MACHINE = MACHINES["dfki_double_pendulum"]
NAMES = "double_chirp_both", "double_chirp_both_c"
TERMS = "viscous", "coulomb", "armature"
RICH = 1
"""the recording whose motion does not repeat itself"""
DT, COARSE = 0.002, 0.02
"""sampling time of the logs, and for free runs [s]"""
BLOCK_S, RESAMPLES = 0.5, 200
"""of the bootstrap"""
FITTED = "OLS", "ridge", "VB b_true"
"""methods that are compared, of `mcpilco.identification.ALL_METHODS`"""


@dataclass(frozen=True)
class Arguments:
    """Identify a real double pendulum."""

    data: Path
    """folder of the machines' folders, of which `dfki_double_pendulum` is one"""
    out: Path = HERE
    """folder of README.md"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    use_one_thread()
    started = time.process_time()
    motions = [Motion.of(recording) for recording in MACHINE.recordings(arguments.data, DT)]
    robot = published()
    parts = []
    coarse = MACHINE.recordings(arguments.data, COARSE)
    for train, unseen in ((0, 1), (RICH, 1 - RICH)):
        found = {method: fit(robot, motions[train], method) for method in FITTED}
        found["free runs"] = fit_free_runs(robot, coarse[train])
        parts.append(f"Fitted to `{NAMES[train]}`, judged on `{NAMES[unseen]}`:")
        parts.append(errors_table(robot, found, motions[unseen]))
        parts.append(friction_table(robot, found))
    parts.append(f"Base parameters of `{NAMES[RICH]}`, with 95 % intervals of least squares:")
    parts.append(parameters_table(robot, motions[RICH], found["free runs"]))
    parts.append(f"{time.process_time() - started:.0f} CPU seconds, on one thread.")
    fill(arguments.out / "README.md", parts, template=HERE / "README.md")
    print("\n\n".join(parts))
    return 0


def published() -> RigidBody:
    """The authors' model with friction."""
    model = mujoco.MjModel.from_xml_path(str(HERE / "double_pendulum.xml"))
    return RigidBody.of(model, TERMS)


# Fits ---------------------------------------------------------------------------------------------


def fit(robot: RigidBody, motion: Motion, method: str) -> Float[np.ndarray, " D"]:
    """Consistent parameters; what no force depends on stays as the authors have it.

    Rows of a joint are divided by what least squares leaves over in it.
    """
    Y, left = rows(robot, motion)
    estimate = robot.nominal + solve(Y, left, method)
    std = (left - Y @ (estimate - robot.nominal)).std(axis=0)
    Y, left = Y / std[:, None], left / std
    estimate = robot.nominal + solve(Y, left, method)
    return project(robot, estimate, Moments.of(Y, left).xx).theta


def rows(robot: RigidBody, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    """Regressor, and what the authors' model leaves over of the torques."""
    Y = low_passed(robot.regressor(motion.q, motion.dq, motion.ddq))
    return Y, low_passed(motion.tau) - Y @ robot.nominal


def solve(Y: np.ndarray, tau: np.ndarray, method: str) -> Float[np.ndarray, " D"]:
    """What a method finds for the base parameters, as the least change of all parameters."""
    base = base_parameters(Y)
    beta = identification.solve(Rows(base.columns(Y), tau), method).b
    G = np.zeros((len(base), Y.shape[-1]))
    G[:, base.independent], G[:, base.dependent] = np.eye(len(base)), base.K
    return np.linalg.pinv(G) @ beta


# Errors -------------------------------------------------------------------------------------------


def errors_table(
    robot: RigidBody, found: Mapping[str, Float[np.ndarray, " D"]], unseen: Motion
) -> str:
    """The authors' models, and what each method found."""
    rows = {
        "authors, no friction": judge.errors(robot, judge.without_friction(robot), unseen),
        "authors": judge.errors(robot, robot.nominal, unseen, judge.SLOPE),
        **{method: judge.errors(robot, theta, unseen) for method, theta in found.items()},
    }
    header = (
        "parameters",
        "torque, shoulder [N m]",
        "torque, elbow [N m]",
        f"angle after {judge.HORIZON_S} s, shoulder [rad]",
        "elbow [rad]",
        "bodies can exist",
    )
    cells = [
        (
            name,
            *(f"{value:.3f}" for value in (*e.torque, *e.angle)),
            yes(robot, found.get(name, robot.nominal)),
        )
        for name, e in rows.items()
    ]
    return markdown(header, cells)


def yes(robot: RigidBody, theta: Float[np.ndarray, " D"]) -> str:
    """Whether bodies can have these parameters."""
    return "yes" if all(link.consistent for link in check_links(robot, theta)) else "no"


def friction_table(robot: RigidBody, found: Mapping[str, Float[np.ndarray, " D"]]) -> str:
    """Friction and motors' inertias, which no sum hides but the shoulder's inertia."""
    names = [f"{joint}_{term}" for joint in robot.chain.joints for term in TERMS]
    places = [robot.names.index(name) for name in names]
    header = (
        "parameters",
        *(f"{name} [{robot.units[n]}]" for name, n in zip(names, places, strict=True)),
    )
    rows = {"authors": robot.nominal, **found}
    return markdown(
        header, [(name, *(f"{theta[n]:.4f}" for n in places)) for name, theta in rows.items()]
    )


# Parameters ---------------------------------------------------------------------------------------


def parameters_table(robot: RigidBody, motion: Motion, free_runs: Float[np.ndarray, " D"]) -> str:
    """Base parameters by least squares, with a block bootstrap, by free runs, and the authors'."""
    Y, left = rows(robot, motion)
    base = base_parameters(Y)
    first = solve(Y, left, "OLS")
    std = (left - Y @ first).std(axis=0)
    X, y = base.columns(Y) / std[:, None], (left + Y @ robot.nominal) / std
    blocks = np.arange(len(y)) // round(BLOCK_S / (KEPT * motion.recording.dt))
    each = [Moments.of(X[blocks == n], y[blocks == n]) for n in np.unique(blocks)]
    rng = np.random.default_rng(0)
    draws = [
        total([each[n] for n in rng.integers(len(each), size=len(each))]).least_squares()
        for _ in range(RESAMPLES)
    ]
    low, high = np.percentile(draws, [2.5, 97.5], axis=0)
    best = total(each).least_squares()
    units = [robot.units[n] for n in base.independent]
    cells = [
        (name, f"{value:.4f} ({a:.4f} to {b:.4f})", f"{ours:.4f}", f"{theirs:.4f}", unit)
        for name, value, a, b, ours, theirs, unit in zip(
            base.formulas(robot.names),
            best,
            low,
            high,
            base.of(free_runs),
            base.of(robot.nominal),
            units,
            strict=True,
        )
    ]
    return markdown(("parameter", "least squares", "free runs", "authors", "unit"), cells)


def total(parts: list[Moments]) -> Moments:
    """Of all samples."""
    found = parts[0]
    for part in parts[1:]:
        found = found + part
    return found


if __name__ == "__main__":
    sys.exit(main())
