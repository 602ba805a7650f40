"""Two robots controlled with what was identified of them: how far are they off?

python runs/ting_robots/run.py --quick       # does it run at all?
python runs/ting_robots/run.py               # both robots, two noises, seeds 0:10
python runs/ting_robots/run.py --seeds 10:20

Results are kept in results/<robot>-<noise>/, a file a seed; the same command goes on where it was
stopped, measures what is new in its tables, and rewrites README.md between its marked lines from
all results that are there.

Reference: Ting et al., sections IV-B and IV-C, tables I and II.
"""

from __future__ import annotations

import copy
import sys
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import tyro
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # harness.py, wherever it is run from

from harness import fill, folder, keep, kept, parse_seeds, places

from envs.arms import control_times, follow, load, measured, random_sinusoids
from mcpilco.identification import (
    ALL_METHODS,
    PROJECTIONS,
    Feedback,
    Recipe,
    RigidBody,
    Rows,
    check_links,
    force_errors,
    simulated_regressor,
    solve,
)
from mcpilco.logbook import read_json
from mcpilco.recordings import (
    JointMotion,
    Recording,
    Segment,
    encoder_noise,
    local_cubics,
    motion_cutoff,
    zero_phase,
)
from mcpilco.sweep import machine as processor
from mcpilco.sweep import markdown
from mcpilco.typing import McPilcoError

HERE = Path(__file__).parent
ROBOTS = ("vision_head", "arm_hand")
NOISES = (2e-4, 1e-3)
"""standard deviations of the encoders' noise [rad]"""
CELLS = {f"{robot}-{noise:g}": (robot, noise) for robot in ROBOTS for noise in NOISES}
SECONDS, TEST_SECONDS = 30.0, 4.0
"""of the recording, and of the test under control [s]"""
STEP = 10
"""samples to a row of local cubics"""
TERMS = ("viscous",)
"""what the models have in each joint; the robots have dry friction, too"""


class Row(NamedTuple):
    """Of the tables."""

    name: str
    filter: str
    """zero-phase or local cubics"""
    recipe: Recipe
    terms: tuple[str, ...] = TERMS


def _row(method: str, projection: str, filter: str = "zero-phase", rows: Any = "weighted") -> Row:
    signs = {"none": "", "virtual": " + eq. (5)", "pseudo-inertia": " + pseudo-inertia"}
    recipe = Recipe(method, projection, rows)
    return Row(f"{method}{signs[projection]}", filter, recipe)


SEED_ROWS = [
    _row(method, projection, "local cubics", "plain")
    for method, projection in (
        ("ridge", "virtual"),
        ("VB b_true", "virtual"),
        ("LASSO", "virtual"),
        ("stepwise", "virtual"),
        ("OLS", "none"),
        ("OLS", "pseudo-inertia"),
    )
]
"""derivatives and rows as a reader of the paper makes them; the first four are in its tables"""
WEIGHTED_ROWS = [
    _row("ridge", "virtual", "local cubics"),
    _row("OLS", "pseudo-inertia", "local cubics"),
    _row("EIV", "pseudo-inertia", "local cubics"),
]
OUR_ROWS = [
    *(_row(method, "none") for method in ALL_METHODS),
    *(_row(method, "virtual") for method in ("ridge", "VB b_true", "EIV")),
    *(_row(method, "pseudo-inertia") for method in ALL_METHODS),
]
ROWS = {
    "local cubics, rows as they are": SEED_ROWS,
    "local cubics, weighted rows": WEIGHTED_ROWS,
    "zero-phase filter, weighted rows": OUR_ROWS,
    "and with dry friction in the model": [
        _row("EIV", "pseudo-inertia")._replace(terms=("viscous", "coulomb"))
    ],
}
BLOCKS = tuple(ROWS)
DEFAULT = (BLOCKS[2], f"{Recipe().method} + pseudo-inertia")
BASELINE = (BLOCKS[0], "ridge + eq. (5)")
QUICK = ("OLS", "ridge", Recipe().method)
"""methods of `--quick`"""
TRUE = "the true parameters, without dry friction"


@dataclass(frozen=True)
class Arguments:
    """Record, identify with all methods, control with each result, and write the tables."""

    seeds: str = "0:10"
    """`0:10` are 0 to 9"""
    quick: bool = False
    """one seed of short recordings and few methods; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    seeds = parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]
    for seed in seeds:
        for cell, (robot, noise) in CELLS.items():
            path = out / "results" / cell / f"{seed:04d}.json"
            known = read_json(path) if path.exists() else None
            if known is None or missing(known, quick=arguments.quick):
                found = trial(robot, noise, seed, quick=arguments.quick, known=known)
                keep(path, found, HERE.name, continued=known is not None)
                ours, theirs = (found["rows"][a][b]["position"] for a, b in (DEFAULT, BASELINE))
                print(f"{cell}, seed {seed}: {ours:.4f} rad, ridge + eq. (5) {theirs:.4f} rad")
        write_readme(out, quick=arguments.quick)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return 0


def missing(known: Mapping[str, Any], *, quick: bool) -> dict[str, list[Row]]:
    """Rows of the tables, by block, that a trial has not measured yet."""
    lacking = {
        block: [
            row
            for row in rows
            if row.name not in known["rows"].get(block, {})
            and (not quick or row.recipe.method in QUICK)
        ]
        for block, rows in ROWS.items()
    }
    return {block: rows for block, rows in lacking.items() if rows}


def trial(
    robot: str,
    noise: float,
    seed: int,
    *,
    quick: bool = False,
    known: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """What all methods find in one recording, and how the robot follows a new motion with each.

    What is known of the trial is kept: a row that is new in the tables is measured alone.
    """
    model, begun = load(robot), time.process_time()
    rng = np.random.default_rng([seed, ROBOTS.index(robot), round(1e6 * noise)])
    followed = follow(
        model, random_sinusoids(model, rng), 8.0 if quick else SECONDS, rng, encoder_std=noise
    )
    recording = measured(model, followed, rng)
    test = Test(model, noise, seed, 1.0 if quick else TEST_SECONDS)
    known = known or {"rows": {}, "cpu_s": 0.0}
    found = {block: dict(known["rows"].get(block, {})) for block in ROWS}
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what EIV and the variational EM say of their data
        fits = Fits(model, recording, seed)
        for block, rows in missing(known, quick=quick).items():
            found[block] |= {row.name: judged(test, row, fits) for row in rows}
        body = RigidBody.of(model, TERMS)
        true = {TRUE: test(body, body.nominal)}
    return {
        "seed": seed,
        "rows": found,
        "true": true,
        "recording_s": float(recording.time[-1]),
        "cpu_s": known["cpu_s"] + time.process_time() - begun,
        "machine": processor(),
    }


def judged(test: Test, row: Row, fits: Fits) -> dict[str, Any]:
    """What a method found, and how well the robot is controlled with it."""
    begun = time.process_time()
    try:
        theta = fits(row)
    except (ArithmeticError, np.linalg.LinAlgError, McPilcoError) as error:
        return {"failed": str(error)}
    cpu = time.process_time() - begun
    return {**test(RigidBody.of(test.model, row.terms), theta), "fit_cpu_s": cpu}


class Fits:
    """Parameters of all rows of the tables; what several have in common is done once."""

    def __init__(self, model: mujoco.MjModel, recording: Recording, seed: int) -> None:
        self._model, self._recording, self._seed = model, recording, seed

    def __call__(self, row: Row) -> np.ndarray:
        key = (row.filter, row.recipe.rows, row.terms)
        project = PROJECTIONS[row.recipe.projection]
        found = project(
            RigidBody.of(self._model, row.terms),
            self._raw(*key, row.recipe.method),
            self._rows(*key).metric,
        )
        return found.theta

    @cache  # noqa: B019  of one trial
    def _raw(self, filter: str, rows: str, terms: tuple[str, ...], method: str) -> np.ndarray:
        return solve(self._rows(filter, rows, terms), method, self._seed).b

    @cache  # noqa: B019
    def _rows(self, filter: str, rows: str, terms: tuple[str, ...]) -> Rows:
        found = rows_of(self._model, RigidBody.of(self._model, terms), self._recording, filter)
        return found.scaled(force_errors(found)) if rows == "weighted" else found


def rows_of(model: mujoco.MjModel, body: RigidBody, recording: Recording, filter: str) -> Rows:
    """A recording as rows of the regression."""
    J, dt = len(body.chain.bodies), recording.dt
    encoder, reference = recording.states[:, :J], recording.states[:, J:]
    unknown, nothing = np.full_like(encoder, np.nan), np.zeros_like(encoder)
    cutoff = motion_cutoff(encoder, dt)

    def filtered(q: np.ndarray, tau: np.ndarray = nothing) -> JointMotion:
        if filter == "zero-phase":
            return zero_phase(q, unknown, tau, dt, cutoff)
        return local_cubics(q, unknown, tau, dt, step=STEP)

    more = np.random.default_rng(0).normal(size=encoder.shape) * encoder_noise(encoder, dt)
    motion, commanded = filtered(encoder, recording.inputs), filtered(reference)
    rows = Rows.of(body, motion, filtered(more), commanded)
    if filter != "zero-phase":
        return rows
    feedback = Feedback.of(motion, commanded, body.chain.joints)
    segment = Segment(recording.name, dt, encoder, unknown, recording.inputs, reference)
    simulate = simulated_regressor(bare(model), body, segment, rows, feedback, filtered)
    return replace(rows, simulate=simulate)


def bare(model: mujoco.MjModel) -> mujoco.MjModel:
    """The robot without what its joints have: simulations shall not know more than the rows."""
    found = copy.deepcopy(model)
    for what in (found.dof_frictionloss, found.dof_damping, found.dof_armature):
        what[:] = 0.0
    return found


class Test:
    """A motion of its own, followed under computed torque."""

    def __init__(self, model: mujoco.MjModel, noise: float, seed: int, seconds: float) -> None:
        rng = np.random.default_rng([seed, 1])
        self.model, self._noise, self._seconds = model, noise, seconds
        self._motion = random_sinusoids(model, rng)
        self._seed = seed
        self._at = self._motion.at(control_times(model, seconds))
        truth = RigidBody.of(model, ("viscous", "coulomb"))
        self._true = truth.regressor(*self._at) @ truth.nominal

    def __call__(self, body: RigidBody, theta: np.ndarray) -> dict[str, Any]:
        """Errors with these parameters: root mean squares in time, means over joints."""
        forces = body.regressor(*self._at) @ theta
        followed = follow(
            self.model,
            self._motion,
            self._seconds,
            np.random.default_rng([self._seed, 2]),
            feedforward=forces,
            encoder_std=self._noise,
        )
        q, dq, _ = (part[: len(followed.time)] for part in self._at)
        squares = ((forces - self._true) ** 2).mean(axis=0) / self._true.var(axis=0)
        links = check_links(body, theta)
        return {
            "position": _rms(followed.position - q),
            "velocity": _rms(followed.velocity - dq),
            "feedback": _rms(followed.feedback),
            "torque_nmse": float(squares.mean()),
            "stopped": followed.stopped,
            "consistent": sum(link.consistent for link in links),
            "links": len(links),
        }


def _rms(error: np.ndarray) -> float:
    return float(np.sqrt((error**2).mean(axis=0)).mean())


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path, *, quick: bool = False) -> None:
    """Put the tables of the results that are there into README.md; all rows or none of a trial."""
    read = {cell: kept(out / "results" / cell) for cell in CELLS}
    whole = {
        cell: [trial for trial in trials if not missing(trial, quick=quick)]
        for cell, trials in read.items()
    }
    found = {cell: trials for cell, trials in whole.items() if trials}
    parts = [
        summary(found),
        *(part for cell, trials in found.items() for part in tables(cell, trials)),
    ]
    fill(out / "README.md", [*parts, machine(found)], template=HERE / "README.md")


def summary(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The default method beside the seed's baseline, and beside the same one on the same rows."""
    lines = []
    for cell, trials in found.items():
        ours = _column(trials, *DEFAULT, "position")
        others = [
            _column(trials, block, row.name, "position")
            for block in BLOCKS[:3]
            for row in ROWS[block]
            if row.name in trials[0]["rows"][block] and (block, row.name) != DEFAULT
        ]
        worst = sum(np.all([o[k] < ours[k] for o in others]) for k in range(len(trials)))
        links = [trial["rows"][DEFAULT[0]][DEFAULT[1]] for trial in trials]
        whole = sum(link["consistent"] == link["links"] for link in links)
        ratios = [
            float(np.median(ours / _column(trials, block, "ridge + eq. (5)", "position")))
            for block in BLOCKS[:3]
        ]
        cells = [f"{ratio:.2f}" for ratio in ratios]
        lines.append((cell, f"{whole} of {len(trials)}", *cells, f"{worst} of {len(trials)}"))
    header = (
        "robot and encoder noise [rad]",
        "seeds with all links consistent",
        *(f"position error / that of ridge + eq. (5), {block}" for block in BLOCKS[:3]),
        "seeds on which it is the worst",
    )
    return (
        f"### `{DEFAULT[1]}`, the default of `mcpilco identify`\n\n{markdown(header, lines)}\n"
        "Ratios: median over seeds."
    )


def tables(cell: str, trials: Sequence[Mapping[str, Any]]) -> list[str]:
    robot, noise = CELLS[cell]
    parts = [f"### {robot}, encoder noise {noise:g} rad, {len(trials)} seeds"]
    for block in BLOCKS:
        names = [row.name for row in ROWS[block] if row.name in trials[0]["rows"][block]]
        lines = [_line(name, [t["rows"][block][name] for t in trials]) for name in names]
        if block == BLOCKS[-1]:
            lines.append(_line(TRUE, [t["true"][TRUE] for t in trials]))
        parts.append(f"{block[0].upper()}{block[1:]}:\n\n{markdown(HEADER, lines)}")
    return parts


HEADER = (
    "method",
    "position [rad]",
    "velocity [rad/s]",
    "feedback [N m]",
    "force nMSE",
    "consistent links",
    "failures",
)


def _line(name: str, results: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    ran = [result for result in results if "failed" not in result]
    failed = len(results) - sum(not result["stopped"] for result in ran)
    keys = ("position", "velocity", "feedback", "torque_nmse")
    least = min((result["consistent"] for result in ran), default=0)
    links = f"{least} of {ran[0]['links']}" if ran else ""
    cells = [_spread([result[key] for result in ran]) for key in keys]
    return (name, *cells, links, f"{failed} of {len(results)}")


def _spread(values: Sequence[float]) -> str:
    if not values:
        return ""
    return f"{np.median(values):.4g} ({min(values):.3g} to {max(values):.3g})"


def _column(trials: Sequence[Mapping[str, Any]], block: str, name: str, key: str) -> np.ndarray:
    """One number a trial; infinite where the method or the robot failed."""
    results = [trial["rows"][block][name] for trial in trials]
    return np.array(
        [np.inf if "failed" in r or r["stopped"] else r[key] for r in results], dtype=float
    )


def machine(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    every = [trial for trials in found.values() for trial in trials]
    cpu = np.median([trial["cpu_s"] for trial in every])
    return f"{places(every)}\n\nA trial: {cpu:.0f} CPU seconds in the median."


if __name__ == "__main__":
    sys.exit(main())
