"""Kinematics from markers: triplets, chains, forward kinematics, and a controller that uses it.

python runs/kinematics/run.py --quick       # does it run at all?
python runs/kinematics/run.py               # 64 robots, then arms of seeds 0:5
python runs/kinematics/run.py --seeds 5:10  # more arms

Results are kept in results/<part>/, a file a seed; the same command goes on where it was stopped,
and rewrites README.md between its marked lines from all results that are there.

Reference: thesis chapter 2, section 2.6.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from scipy.spatial.transform import Rotation
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # harness.py and paths.py, wherever it is run from

from harness import fill, folder, keep, kept, parse_seeds, places
from kinematics.paths import UR10, random_way_points, through

from envs.arms.marked import IDEAL, Camera, MarkedArm, marked_arm, random_marked_arm
from envs.arms.motions import RANGES, sinusoids
from mcpilco.gp import GP
from mcpilco.identification.kinematics import (
    POSE_OUTPUTS,
    ForwardKinematics,
    Tolerance,
    find_chain,
    fit_forward,
    orthonormal,
    pose_samples,
    reach,
    rows_for_fit,
    triplet_tests,
)
from mcpilco.kernels import RBF
from mcpilco.recordings import MarkerRecording, marker_recording
from mcpilco.sweep import machine, markdown
from mcpilco.typing import InputError

HERE = Path(__file__).parent
ROBOTS, JOINTS, SAMPLES = 64, 5, 50
NOISY = Camera(position_std=0.003, orientation_std=0.01)
BAD = Camera(0.003, 0.01, outliers=0.05, missing=0.1, encoder_std=1e-3)
STRUCTURE = {
    "noise-free": (IDEAL, Tolerance(1e-6, 1e-5, 0.0)),
    "noise": (NOISY, Tolerance(outliers=0.0)),
    "outliers": (BAD, Tolerance()),
    "outliers-0.3": (BAD, Tolerance(outliers=0.3)),
}
"""the camera, and the tolerances of the tests"""
TESTS = ("P1", "P2 alone", "P3 alone", "P2 and P3")
FORWARD = {"100-small": (100, 0.5), "300-small": (300, 0.5), "300-large": (300, 1.0)}
"""samples, and the share of the joints' range that the way-points are in"""
PRIORS = ("RBF", "product", "nested")
WAY_POINTS, LEG = 25, 87
COVERING = (25, 100, 400)
"""way-points of about as long a path"""
IN_THE_BOX = 500
"""poses that a model is tested at"""
TARGETS = 5
NU, LITERAL_STEPS = 0.02, 300
REFITS = 3
CONTROLLERS = (
    "(2.24) as printed",
    "mended",
    *(f"mended, refit {n} with the poses reached" for n in range(1, REFITS + 1)),
)


@dataclass(frozen=True)
class Arguments:
    """Test all triplets, learn forward kinematics, reach poses, and write the tables."""

    seeds: str = "0:5"
    """of the arms for forward kinematics and controller; `0:5` are 0 to 4"""
    quick: bool = False
    """two robots and one arm with few samples; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/ and README.md; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    quick = arguments.quick
    out = folder(HERE, arguments.out, quick)
    torch.set_num_threads(1)
    with threadpool_limits(1):
        for cell in STRUCTURE:
            for robot in range(2 if quick else ROBOTS):
                measured(out / "results" / cell / f"{robot:04d}.json", structure, cell, robot)
        write_readme(out)
        for seed in parse_seeds(arguments.seeds)[: 1 if quick else None]:
            for cell in FORWARD:
                measured(out / "results" / cell / f"{seed:04d}.json", forward, cell, seed, quick)
                write_readme(out)  # a stop loses no table
            measured(out / "results" / "controller" / f"{seed:04d}.json", control, seed, quick)
            write_readme(out)
            measured(out / "results" / "covering" / f"{seed:04d}.json", covering, seed, quick)
            write_readme(out)
    print(f"Tables: {out / 'README.md'}")
    return 0


def measured(path: Path, measure: Callable[..., dict[str, Any]], *arguments: Any) -> None:
    """Measure and keep what has not been measured yet."""
    if path.exists():
        return
    begun = time.process_time()
    found = {
        **measure(*arguments),
        "cpu_s": time.process_time() - begun,
        "machine": machine(),
    }
    keep(path, found, HERE.name)
    print(f"{path.parent.name}, seed {path.stem}: {found['cpu_s']:.1f} CPU s", flush=True)


# Structure ----------------------------------------------------------------------------------------


def structure(cell: str, robot: int) -> dict[str, Any]:
    """Hits and errors of all tests on the 75 triplets of a random robot, and its chain."""
    rng = np.random.default_rng([robot, 2])
    arm = random_marked_arm(rng, JOINTS)
    when = 0.1 * np.arange(SAMPLES)
    q = sinusoids(when, arm.kinds, rng)
    camera, tolerance = STRUCTURE[cell]
    recording = marker_recording(arm.log(when, q, camera, rng))
    tests = triplet_tests(recording, tolerance.outliers)
    slide = (tests.slide < tolerance.position) & (tests.rigid < tolerance.orientation)[:, None]
    hinge = np.repeat((tests.hinge < tolerance.position)[:, None], JOINTS, axis=1)
    turn = tests.turn < tolerance.orientation
    slides, hinges = (connected(arm, recording, tests.pairs, kind) for kind in ("slide", "hinge"))
    answers = dict(zip(TESTS, (slide, hinge, turn, hinge & turn), strict=True))
    return {
        "counts": {
            test: counts(answer, slides if test == "P1" else hinges)
            for test, answer in answers.items()
        },
        "chain": chain_is_exact(arm, recording, tolerance),
    }


def connected(
    arm: MarkedArm, recording: MarkerRecording, pairs: np.ndarray, kind: str
) -> np.ndarray:
    """Which pairs of markers and joints are connected by a joint of this kind."""
    found = np.zeros((len(pairs), JOINTS), dtype=bool)
    for place, joint in enumerate(arm.joints):
        pair = sorted(recording.marker_names.index(arm.markers[place + k]) for k in (0, 1))
        row = np.flatnonzero((pairs == pair).all(1))
        found[row, recording.joint_names.index(joint)] = arm.kinds[place] == kind
    return found


def counts(answer: np.ndarray, truth: np.ndarray) -> list[int]:
    """True and false positives, false and true negatives."""
    cells = (answer & truth, answer & ~truth, ~answer & truth, ~answer & ~truth)
    return [int(cell.sum()) for cell in cells]


def chain_is_exact(arm: MarkedArm, recording: MarkerRecording, tolerance: Tolerance) -> bool:
    try:
        chain = find_chain(recording, tolerance)
    except InputError:
        return False
    joints = [(joint.name, joint.kind) for joint in chain.joints]
    return chain.markers == arm.markers and joints == list(zip(arm.joints, arm.kinds, strict=True))


# Forward kinematics -------------------------------------------------------------------------------


@dataclass(frozen=True)
class Setting:
    """An arm, what a camera saw of it, and another path through the same way-points."""

    arm: MarkedArm
    recording: MarkerRecording
    q_test: np.ndarray
    rng: np.random.Generator


def setting(seed: int, share: float, quick: bool, count: int = WAY_POINTS) -> Setting:
    rng = np.random.default_rng([seed, 3])
    arm = marked_arm(UR10, rng)
    points = random_way_points(count, arm.kinds, rng, share)
    leg = (10 if quick else LEG) * (WAY_POINTS - 1) // (count - 1)
    q, q_test = (through(points, rng.permutation(count), max(leg, 1)) for _ in range(2))
    recording = marker_recording(arm.log(np.arange(float(len(q))), q, NOISY, rng))
    return Setting(arm, recording, q_test, rng)


def forward(cell: str, seed: int, quick: bool) -> dict[str, Any]:
    """Errors of three priors, all on the same samples, on a path of another order."""
    samples, share = FORWARD[cell]
    given = setting(seed, share, quick)
    samples = 40 if quick else samples
    chain = find_chain(given.recording)
    marker = chain.markers[-1]
    rows = rows_for_fit(given.recording, marker, samples, seed)
    chosen = given.recording[rows]
    order = [given.arm.joints.index(joint.name) for joint in chain.joints]
    q_test = torch.as_tensor(given.q_test[:, order])
    truth = true_pose(given.arm, given.q_test)
    found: dict[str, Any] = {"samples": samples}
    for prior in PRIORS:
        begun = time.process_time()
        if prior == "RBF":
            q, Y = pose_samples(chosen, [joint.name for joint in chain.joints], marker)
            p, R = rbf_pose(q, Y, q_test)
            evidence = []
        else:
            model = fit_forward(chosen, chain, samples, prior, seed)
            with torch.no_grad():
                p, R = model.pose(q_test)
            evidence = list(model.report.evidence)
        found[prior] = {
            **errors(p.numpy(), R.numpy(), *truth),
            "evidence": evidence,
            "cpu_s": time.process_time() - begun,
        }
    return found


def rbf_pose(
    q: torch.Tensor, Y: torch.Tensor, q_test: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """The same outputs, learned with an RBF kernel of the joint positions."""
    mean = Y.mean(0)
    gp = GP(RBF(q.shape[1], (len(POSE_OUTPUTS),)), noise_floor=1e-5).fit(q, Y - mean)
    Y_test = gp.condition(q, Y - mean).mean_and_variance(q_test)[0] + mean
    return Y_test[:, :3], orthonormal(Y_test[:, 3:6], Y_test[:, 6:9])


def true_pose(arm: MarkedArm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation matrix of the last marker, without noise."""
    positions, orientations = arm.poses(q)
    matrices = orientations.as_matrix().reshape(len(q), -1, 3, 3)
    return positions[:, -1], matrices[:, -1]


def errors(p: np.ndarray, R: np.ndarray, p_true: np.ndarray, R_true: np.ndarray) -> dict[str, Any]:
    """Root mean squares: of the position [m], of yaw, pitch and roll, of the angle [rad]."""
    angles = [Rotation.from_matrix(matrix).as_euler("ZYX") for matrix in (R, R_true)]
    ypr = (angles[0] - angles[1] + np.pi) % (2 * np.pi) - np.pi
    turned = Rotation.from_matrix(R.swapaxes(1, 2) @ R_true).magnitude()
    return {
        "position_m": np.sqrt(((p - p_true) ** 2).mean(0)).tolist(),
        "ypr_rad": np.sqrt((ypr**2).mean(0)).tolist(),
        "angle_rad": float(np.sqrt((turned**2).mean())),
    }


# Controller ---------------------------------------------------------------------------------------


def control(seed: int, quick: bool) -> dict[str, Any]:
    """True errors of the poses that the controllers lead to, from one start to the same targets."""
    given = setting(seed, 0.5, quick)
    chain = find_chain(given.recording)
    samples = 40 if quick else 300
    rows = rows_for_fit(given.recording, chain.markers[-1], samples, seed)
    chosen = given.recording[rows]
    model = fit_forward(chosen, chain, samples)
    order = [given.arm.joints.index(joint.name) for joint in chain.joints]
    goals = random_way_points(2 if quick else TARGETS, given.arm.kinds, given.rng, 0.5)
    targets = true_pose(given.arm, goals)
    back = np.argsort(order)

    def reached(ends: Sequence[torch.Tensor]) -> np.ndarray:
        return torch.stack(list(ends)).numpy()[:, back]

    def all_of(model: ForwardKinematics, way: Callable[..., torch.Tensor]) -> np.ndarray:
        start = torch.zeros(len(order), dtype=torch.float64)
        pairs = zip(*map(torch.as_tensor, targets), strict=True)
        return reached([way(model, start, p, R) for p, R in pairs])

    inside = _inside(model.q.numpy(), goals[:, order])
    ends = {CONTROLLERS[0]: all_of(model, literal)}
    seen = chosen
    for name in CONTROLLERS[1:]:
        ends[name] = all_of(model, mended)
        later = given.recording.time[-1] + 1.0 + np.arange(len(seen), len(seen) + len(goals))
        log = given.arm.log(later, ends[name], NOISY, given.rng)
        seen = joined(seen, marker_recording(log))
        model = fit_forward(seen, chain, len(seen))
    found: dict[str, Any] = {}
    for name, q in ends.items():
        reached_pose = true_pose(given.arm, q)
        for where, rows in (("inside", inside), ("outside", ~inside)):
            if rows.any():
                parts = (part[rows] for part in (*reached_pose, *targets))
                found[f"{name}, {where}"] = {"targets": int(rows.sum()), **errors(*parts)}
    return found


def covering(seed: int, quick: bool) -> dict[str, Any]:
    """Errors on a path through the way-points, anywhere between them, and of the poses reached.

    By how many way-points the path of the samples leads through; it is about as long.
    """
    found: dict[str, Any] = {}
    for count in COVERING[: 2 if quick else None]:
        given = setting(seed, 0.5, quick, count)
        chain = find_chain(given.recording)
        rows = rows_for_fit(given.recording, chain.markers[-1], 40 if quick else 300, seed)
        chosen = given.recording[rows]
        model = fit_forward(chosen, chain, len(chosen))
        order = [given.arm.joints.index(joint.name) for joint in chain.joints]
        box, goals = (
            random_way_points(poses, given.arm.kinds, given.rng, 0.5)
            for poses in (IN_THE_BOX, 2 if quick else TARGETS)
        )
        start = torch.zeros(len(order), dtype=torch.float64)
        targets = true_pose(given.arm, goals)
        pairs = zip(*map(torch.as_tensor, targets), strict=True)
        ends = torch.stack([mended(model, start, p, R) for p, R in pairs]).numpy()
        found[str(count)] = {
            "reached": errors(*true_pose(given.arm, ends[:, np.argsort(order)]), *targets),
            **{
                name: errors(*_predicted(model, q[:, order]), *true_pose(given.arm, q))
                for name, q in {"path": given.q_test, "box": box}.items()
            },
        }
    return found


def _predicted(model: ForwardKinematics, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with torch.no_grad():
        p, R = model.pose(torch.as_tensor(q))
    return p.numpy(), R.numpy()


def _inside(samples: np.ndarray, goals: np.ndarray) -> np.ndarray:
    """Whether each joint of a goal is within the range of the samples."""
    return ((goals >= samples.min(0)) & (goals <= samples.max(0))).all(1)


def mended(model: ForwardKinematics, start: Any, p: Any, R: Any) -> torch.Tensor:
    return reach(model, start, p, R).q[-1]


def literal(model: ForwardKinematics, start: Any, p: Any, R: Any) -> torch.Tensor:
    """q <- q - nu grad |p* - p|, the pose in metres and in yaw, pitch and roll."""
    target = torch.cat([p, yaw_pitch_roll(R)])
    q = start.clone()
    for _ in range(LITERAL_STEPS):
        q.requires_grad_(True)
        position, rotation = model.pose(q)
        error = (target - torch.cat([position, yaw_pitch_roll(rotation)])).norm()
        (gradient,) = torch.autograd.grad(error, q)
        q = (q - NU * gradient).detach()
    return q


def yaw_pitch_roll(R: torch.Tensor) -> torch.Tensor:
    yaw = torch.atan2(R[1, 0], R[0, 0])
    pitch = torch.atan2(-R[2, 0], torch.hypot(R[2, 1], R[2, 2]))
    return torch.stack([yaw, pitch, torch.atan2(R[2, 1], R[2, 2])])


def joined(first: MarkerRecording, second: MarkerRecording) -> MarkerRecording:
    columns = first.columns()
    return marker_recording(
        {name: np.concatenate([columns[name], column]) for name, column in second.columns().items()}
    )


# The tables ---------------------------------------------------------------------------------------


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    cells = (*STRUCTURE, *FORWARD, "controller", "covering")
    found = {part: kept(out / "results" / part) for part in cells}
    parts = ["### Triplets and chains", structure_table(found)]
    if any(found[cell] for cell in FORWARD):
        parts += ["### Forward kinematics: RMSE, median over arms (least to greatest)"]
        parts += [forward_table(found), ratio_table(found)]
    if found["controller"]:
        parts += ["### Controller: RMSE of the poses reached, over all arms and targets"]
        parts += [controller_table(found["controller"])]
    if found["covering"]:
        parts += ["### Why: way-points of the samples, and RMSE in x, y, z over all arms [mm]"]
        parts += [covering_table(found["covering"])]
    parts.append(
        places((trial for trials in found.values() for trial in trials), ", shared with other work")
    )
    fill(out / "README.md", parts, template=HERE / "README.md")


def structure_table(found: dict[str, Any]) -> str:
    rows = []
    for cell in STRUCTURE:
        trials = found[cell]
        if trials:
            summed = {t: np.sum([trial["counts"][t] for trial in trials], axis=0) for t in TESTS}
            exact = f"{sum(trial['chain'] for trial in trials)} of {len(trials)}"
            cells = ["/".join(map(str, summed[t])) for t in TESTS]
            cpu = f"{sum(trial['cpu_s'] for trial in trials):.1f}"
            rows.append((cell, str(summed["P1"].sum()), *cells, exact, cpu))
    return markdown(("data", "triplets", *TESTS, "chains exact", "CPU [s]"), rows) + (
        "\nTrue positives / false positives / false negatives / true negatives."
    )


def cells_of(trials: Sequence[Any], prior: str) -> tuple[str, ...]:
    position = 1e3 * np.array([trial[prior]["position_m"] for trial in trials])
    ypr = np.array([trial[prior]["ypr_rad"] for trial in trials])
    angle = np.array([[trial[prior]["angle_rad"]] for trial in trials])
    mm = [spread(column, 1) for column in position.T]
    rad = [spread(column, 3) for column in np.concatenate([ypr, angle], axis=1).T]
    return (*mm, *rad)


def forward_table(found: dict[str, Any]) -> str:
    rows = []
    for cell in FORWARD:
        trials = found[cell]
        if trials:
            name = row_name(cell, trials)
            for prior in PRIORS:
                cpu = np.median([trial[prior]["cpu_s"] for trial in trials])
                rows.append((name, prior, str(len(trials)), *cells_of(trials, prior), f"{cpu:.1f}"))
    units = ("x [mm]", "y [mm]", "z [mm]", "yaw [rad]", "pitch [rad]", "roll [rad]", "angle [rad]")
    return markdown(("data", "prior", "arms", *units, "CPU [s]"), rows)


def row_name(cell: str, trials: Sequence[Any]) -> str:
    return f"{trials[0]['samples']} samples, ±{FORWARD[cell][1] * RANGES['hinge']:g} rad"


def ratio_table(found: dict[str, Any]) -> str:
    rows = []
    for cell in FORWARD:
        trials = found[cell]
        if trials:
            p = {
                prior: np.median([trial[prior]["position_m"] for trial in trials], axis=0)
                for prior in PRIORS
            }
            name = row_name(cell, trials)
            for prior in PRIORS[1:]:
                rows.append((name, prior, *(f"{value:.2f}" for value in p[prior] / p["RBF"])))
    return "Medians in parts of those of the RBF kernel:\n\n" + markdown(
        ("data", "prior", "x", "y", "z"), rows
    )


def covering_table(trials: Sequence[Any]) -> str:
    rows = []
    for count in trials[0].keys() & set(map(str, COVERING)):
        cells = []
        for where in ("path", "box", "reached"):
            squares = np.square([trial[count][where]["position_m"] for trial in trials])
            cells.append(", ".join(f"{1e3 * rms:.1f}" for rms in np.sqrt(squares.mean(0))))
        rows.append((count, str(len(trials)), *cells))
    header = ("way-points", "arms", "a path through them", "the box", "poses reached")
    return markdown(header, sorted(rows, key=lambda row: int(row[0])))


def controller_table(trials: Sequence[Any]) -> str:
    rows = []
    for where in ("inside", "outside"):
        for name in CONTROLLERS:
            each = [t[f"{name}, {where}"] for t in trials if f"{name}, {where}" in t]
            if each:
                weights = [one["targets"] for one in each]
                position, ypr, angle = (
                    np.sqrt(np.average(np.square([e[key] for e in each]), axis=0, weights=weights))
                    for key in ("position_m", "ypr_rad", "angle_rad")
                )
                mm = [f"{1e3 * value:.1f}" for value in position]
                rad = [f"{value:.3f}" for value in (*ypr, angle)]
                rows.append((where, name, str(sum(weights)), *mm, *rad))
    units = ("x [mm]", "y [mm]", "z [mm]", "yaw [rad]", "pitch [rad]", "roll [rad]", "angle [rad]")
    return markdown(("targets are", "controller", "targets", *units), rows)


def spread(values: np.ndarray, digits: int) -> str:
    low, high = values.min(), values.max()
    return f"{np.median(values):.{digits}f} ({low:.{digits}f} to {high:.{digits}f})"


if __name__ == "__main__":
    sys.exit(main())
