"""Collisions from motor currents: how well currents are foretold, and which pushes are found.

python runs/collision/run.py --quick       # does it run at all?
python runs/collision/run.py               # both controllers, seeds 0:5
python runs/collision/run.py --seeds 5:10

Results are kept in results/<controller>/, a file a seed; the same command goes on where it was
stopped, and rewrites README.md between its marked lines, and the pictures beside it, from all
results that are there.

Reference: thesis chapter 4, figures 4.1 to 4.3.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
import tyro
from threadpoolctl import threadpool_limits

sys.path.append(str(Path(__file__).parents[1]))  # its modules, wherever it is run from

from collision.pages import write_page
from harness import folder, keep, parse_seeds

from envs.arms.motions import Targets, waypoints
from envs.arms.sticky_arm import MODEL, PID, SAMPLING_S, Drives, Push, StickyArm
from mcpilco.files import write_arrays
from mcpilco.identification import RigidBody
from mcpilco.identification.collision import (
    CURRENT_TERMS,
    CurrentConfig,
    CurrentModel,
    Detection,
    ThresholdConfig,
    condition_currents,
    current_prior,
    current_regressors,
    detect,
    events,
    fit_currents,
    inputs_of,
    thresholds,
)
from mcpilco.recordings import ArmSamples, arm_samples
from mcpilco.sweep import machine

HERE = Path(__file__).parent
CONTROLLERS = {"pd": Drives(), "pid": PID}
"""feedback without integral action and a log of the feed-forward; with it, and of the command"""
STRENGTHS = (0.5, 1.5, 3.0)
"""torque of a push about the first joint, in its dry friction [-]"""
PHASES = {"moving": Push(0.0, 0.0), "resting": Push(0.0, 0.0), "leaning": Push(0.0, 0.0, 2.0, 0.7)}
"""when the arm is pushed: in a motion, in a rest, and in a rest by a force that grows slowly"""
DETECTORS: dict[str, tuple[str, ThresholdConfig]] = {
    "PP": ("PP", ThresholdConfig()),
    "SP": ("SP", ThresholdConfig()),
    "FC": ("FC", ThresholdConfig()),
    "PP, maximum": ("PP", ThresholdConfig(quantile=1.0)),
    "SP, maximum": ("SP", ThresholdConfig(quantile=1.0)),
    "FC, maximum": ("FC", ThresholdConfig(quantile=1.0)),
    "PP, by phase": ("PP", ThresholdConfig(by_phase=True)),
    "FC, by phase": ("FC", ThresholdConfig(by_phase=True)),
    "FC of 500 samples": ("FC of 500 samples", ThresholdConfig()),
    "FC of 500 samples, deviations": ("FC of 500 samples", ThresholdConfig(rule="deviations")),
}
"""a model, and how its thresholds are set"""
SHOWN = ("PP", "SP", "FC", "PP of motions")
"""models whose errors are told"""
EITHER = ("FC, maximum", "PP, maximum")
"""two detectors that watch together"""
FEW = 500
"""samples of the model of which variances are asked for: they take time"""


@dataclass(frozen=True)
class Size:
    """How much is simulated and fitted."""

    moves: tuple[int, int, int] = (60, 40, 40)
    """to fit to; to set thresholds by; to test"""
    pushes: int = 20
    """of each strength in each phase"""
    config: CurrentConfig = field(default_factory=lambda: CurrentConfig(points=1000))


QUICK = Size((12, 8, 8), 2, CurrentConfig(points=300, fit_points=120, iterations=10))


@dataclass(frozen=True)
class Arguments:
    """Fit, set thresholds, push, and write the tables."""

    seeds: str = "0:5"
    """`0:10` are 0 to 9"""
    quick: bool = False
    """one seed of few data; the tables go to runs/out"""
    out: Path | None = None
    """folder of results/, README.md and pictures; by default that of this file"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    out = folder(HERE, arguments.out, arguments.quick)
    seeds = parse_seeds(arguments.seeds)[: 1 if arguments.quick else None]
    size = QUICK if arguments.quick else Size()
    torch.set_num_threads(1)
    with threadpool_limits(1):
        for seed in seeds:
            for controller in CONTROLLERS:
                path = out / "results" / controller / f"{seed:04d}.json"
                if not path.exists():
                    found, shown = trial(controller, seed, size)
                    keep(path, found, HERE.name)
                    if not (example := path.parent / "shown.npz").exists():
                        write_arrays(example, shown)
                    print(f"{controller}, seed {seed}: {found['cpu_s']:.0f} CPU s", flush=True)
                write_page(out, HERE / "README.md", DETECTORS, EITHER)  # a stop loses no table
    print(f"Tables: {out / 'README.md'}")
    return 0


def trial(controller: str, seed: int, size: Size) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """All figures of one arm, and a stretch of its currents to show."""
    begun = time.process_time()
    rng = np.random.default_rng([seed, list(CONTROLLERS).index(controller)])
    arm = StickyArm.drawn(rng, CONTROLLERS[controller])
    train, calibrate, test = (simulate(arm, waypoints(moves, rng), rng) for moves in size.moves)
    models = learn(train, size.config)
    found = {
        "seed": seed,
        "joints": arm.joints,
        "samples": {"fit": len(train), "thresholds": len(calibrate), "test": len(test)},
        "rmse": {name: errors(models[name], test) for name in SHOWN},
        "detectors": judge(arm, models, calibrate, test, rng, size),
    }
    shown = stretch(arm, models, calibrate, rng)
    return {**found, "cpu_s": time.process_time() - begun, "machine": machine()}, shown


def simulate(
    arm: StickyArm, targets: Targets, rng: np.random.Generator, pushes: tuple[Push, ...] = ()
) -> ArmSamples:
    return arm_samples(arm.follow(targets, rng, pushes))


# Models -------------------------------------------------------------------------------------------


class Remembering:
    """A model that foretells each set of samples once."""

    def __init__(self, model: CurrentModel) -> None:
        self._model, self._told = model, {}
        self.dt, self.joints, self.quiet = model.dt, model.joints, model.quiet

    def mean(self, samples: ArmSamples) -> np.ndarray:
        return self._tell("mean", samples)

    def std(self, samples: ArmSamples) -> np.ndarray:
        return self._tell("std", samples)

    def _tell(self, what: str, samples: ArmSamples) -> np.ndarray:
        key = what, id(samples)
        if key not in self._told:
            self._told[key] = getattr(self._model, what)(samples), samples
        return self._told[key][0]


def learn(train: ArmSamples, config: CurrentConfig) -> dict[str, Any]:
    """The models by name; the last one, of motions alone, says what the others could know."""
    body = RigidBody.of(mujoco.MjModel.from_xml_path(str(MODEL)), terms=CURRENT_TERMS)
    found: dict[str, Any] = {}
    for kind in ("PP", "SP", "FC"):
        model, _ = fit_currents(train, body, SAMPLING_S, replace(config, kind=kind))
        found[kind] = Remembering(model)
    few, _ = fit_currents(train, body, SAMPLING_S, replace(config, points=min(FEW, config.points)))
    found["FC of 500 samples"] = Remembering(few)
    found["PP of motions"] = Remembering(of_motions(train, model, replace(config, kind="PP")))
    return found


def of_motions(train: ArmSamples, model: CurrentModel, config: CurrentConfig) -> CurrentModel:
    """PP, each joint fitted to samples at which it moves; it knows nothing of rests."""
    features, predictors = model.features, []
    for j, gp in enumerate(gps := current_prior(features, config)):
        moving = train[~model.quiet(train)[:, j]].thinned(config.points)
        some = moving.thinned(config.fit_points)
        X = current_regressors(some, inputs_of(some, features, config), j)
        gp.fit(X, torch.from_numpy(some.i[:, j : j + 1]), max_iterations=config.iterations)
        whole, _ = condition_currents(tuple(gps), moving, features, SAMPLING_S, config)
        predictors.append(whole.predictors[j])
    return replace(whole, predictors=tuple(predictors))


def errors(model: Any, test: ArmSamples) -> dict[str, list[float]]:
    """Root mean square errors of each joint [A]."""
    residual, still = test.i - model.mean(test), model.quiet(test)
    return {
        name: np.sqrt((residual**2 * rows).sum(axis=0) / rows.sum(axis=0)).tolist()
        for name, rows in (("moving", ~still), ("resting", still))
    }


# Detectors ----------------------------------------------------------------------------------------


def judge(
    arm: StickyArm,
    models: dict[str, Any],
    calibrate: ArmSamples,
    test: ArmSamples,
    rng: np.random.Generator,
    size: Size,
) -> dict[str, Any]:
    """For each detector its thresholds, its false alarms, and which pushes it finds when."""
    sets = {
        f"{phase} {strength:g}": pushed_set(arm, phase, strength, size.pushes, rng)
        for phase in PHASES
        for strength in STRENGTHS
    }
    found, alarms = {}, {}
    for name, (kind, config) in DETECTORS.items():
        model = models[kind]
        if config.quantile < 1.0 and len(calibrate) < 10_000:  # --quick
            config = replace(config, quantile=0.95)
        limits = thresholds(model, calibrate, config)
        free = detect(model, limits, test)
        over = np.abs(free.residual) >= free.threshold
        pushed = {key: detect(model, limits, samples) for key, (samples, _) in sets.items()}
        alarms[name] = free, pushed
        found[name] = {
            "moving": limits.moving.tolist(),
            "resting": limits.resting.tolist(),
            "samples_above": over.mean(axis=0).tolist(),
            **outcomes(alarms[name], sets, arm.joints),
        }
    both = zip(*(alarms[name] for name in EITHER), strict=True)
    (free_a, free_b), (pushed_a, pushed_b) = both
    either = joined(free_a, free_b), {k: joined(pushed_a[k], pushed_b[k]) for k in sets}
    found["either"] = outcomes(either, sets, arm.joints)
    return found


def joined(a: Detection, b: Detection) -> Detection:
    """Alarms of one or the other."""
    return replace(a, joints=a.joints | b.joints)


def outcomes(alarms: Any, sets: dict[str, Any], joints: tuple[str, ...]) -> dict[str, Any]:
    free, pushed = alarms
    told = {key: hits(pushed[key], pushes) for key, (_, pushes) in sets.items()}
    return {
        "false_alarms": len(events(free, joints)),
        "minutes": float(free.time[-1]) / 60.0,
        "pushes": {key: len(pushes) for key, (_, pushes) in sets.items()},
        "delays_s": told,
    }


def hits(found: Detection, pushes: tuple[Push, ...]) -> list[float]:
    """How long after the start of a push an alarm begins, for those in which one does [s]."""
    alarm = found.collision
    begins = alarm & ~np.concatenate([[False], alarm[:-1]])
    delays = []
    for push in pushes:
        since = found.time - push.start_s
        inside = begins & (since >= 0.0) & (since <= push.duration_s)
        if inside.any():
            delays.append(float(since[inside][0]))
    return delays


def pushed_set(
    arm: StickyArm, phase: str, strength: float, count: int, rng: np.random.Generator
) -> tuple[ArmSamples, tuple[Push, ...]]:
    """So many moves of the first joint, a push in each or after each."""
    how = replace(PHASES[phase], duration_s=PHASES[phase].duration_s or 0.4)
    rest = 1.2 + how.duration_s
    targets = waypoints(count, rng, rest_s=(rest, rest), always=0)
    friction = float(arm.model.dof_frictionloss[0])
    pushes = []
    for move in targets.moves:
        early = move.start_s + rng.uniform(0.25, 0.6) * (move.end_s - move.start_s)
        start = early if phase == "moving" else move.end_s + 0.5
        torque = float(rng.choice([-1.0, 1.0])) * strength * friction
        pushes.append(replace(how, start_s=start, torque=torque))
    return simulate(arm, targets, rng, tuple(pushes)), tuple(pushes)


def stretch(
    arm: StickyArm, models: dict[str, Any], calibrate: ArmSamples, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """Figure 4.3: the first joint in three motions and a rest, pushed three times and twice."""
    targets = waypoints(3, rng, rest_s=(4.0, 4.0), share=0.5, always=0)
    friction = float(arm.model.dof_frictionloss[0])
    starts = [0.5 * (move.start_s + move.end_s) for move in targets.moves]
    strengths = [0.5, -1.5, 0.5, 1.5, -3.0]
    starts += [targets.moves[-1].end_s + after for after in (1.0, 2.4)]
    pushes = tuple(
        Push(start, strength * friction) for start, strength in zip(starts, strengths, strict=True)
    )
    samples = simulate(arm, targets, rng, pushes)
    shown = {
        "time": samples.time,
        "position": samples.q[:, 0],
        "velocity": samples.dq[:, 0],
        "current": samples.i[:, 0],
        "starts": np.array(starts),
        "ends": np.array(starts) + pushes[0].duration_s,
    }
    for kind in ("PP", "SP", "FC"):
        limits = thresholds(models[kind], calibrate, ThresholdConfig(quantile=1.0))
        shown[f"expected_{kind}"] = models[kind].mean(samples)[:, 0]
        shown[f"threshold_{kind}"] = limits.moving[:1]
    return shown


if __name__ == "__main__":
    sys.exit(main())
