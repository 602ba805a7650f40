"""`mcpilco collisions`: what motor currents tell of an arm that is touched."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mcpilco.cli import options
from mcpilco.identification.collision import ThresholdConfig
from mcpilco.typing import InputError

if TYPE_CHECKING:
    import numpy as np

    from mcpilco.identification.collision import CurrentModel, Detection, Event, Thresholds
    from mcpilco.recordings import ArmRecording, ArmSamples

HELD_OUT = 0.3
"""share of each recording, its end, that thresholds are set by where no other is given"""

ModelPath = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="MODEL")]
LimitOptions = Annotated[ThresholdConfig, tyro.conf.arg(name="")]


@dataclass(frozen=True)
class Simulate(options.Command):
    """Record a simulated arm whose joints stick: without contact, and pushed."""

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for arm.xml, free.csv, check.csv and pushed.csv"""
    moves: int = 60
    """of the arm in free.csv and in check.csv; pushed.csv has 8"""
    seed: int = 0
    """of everything random; equal seeds give equal files"""

    def __call__(self) -> int:
        import numpy as np

        from envs.arms.motions import waypoints
        from envs.arms.sticky_arm import MODEL, StickyArm
        from mcpilco.files import make_folder, write_bytes

        options.require_at_least(1, moves=self.moves)
        options.require_at_least(0, seed=self.seed)
        names = ("arm.xml", "free.csv", "check.csv", "pushed.csv")
        make_folder(self.out, *names)
        options.require_new(*(self.out / name for name in names), remedy="name another folder")
        rng = np.random.default_rng(self.seed)
        arm = StickyArm.drawn(rng)
        for name in ("free", "check"):
            self._write(name, arm.follow(waypoints(self.moves, rng), rng))
        targets = waypoints(8, rng, rest_s=(1.6, 1.6), always=0)
        pushes = _pushes(targets, float(arm.model.dof_frictionloss[0]), rng)
        self._write("pushed", arm.follow(targets, rng, pushes))
        write_bytes(self.out / "arm.xml", MODEL.read_bytes())
        print(f"In {self.out}: {', '.join(names)}.")
        return 0

    def _write(self, name: str, log: Any) -> None:
        """A CSV with seven decimals, of which sensors tell five."""
        import numpy as np

        from mcpilco.files import csv_bytes, write_bytes
        from mcpilco.recordings import FORCE, columns_of

        names, table = ["time"], [log.time]
        for j, joint in enumerate(log.joints):
            own = columns_of([joint])
            names += own
            table += [getattr(log, column.removeprefix(f"{joint}_"))[:, j] for column in own]
        if log.pushes:
            names += FORCE
            table += list(log.force.T)
        rows = np.round(np.column_stack(table), 7).tolist()
        write_bytes(self.out / f"{name}.csv", csv_bytes(names, rows))


@dataclass(frozen=True)
class Learn(options.Command):
    """Learn which currents to expect, from recordings without any contact."""

    recordings: options.Files
    """CSV, npz, mat or parquet: time, and for each joint position, velocity, current and targets"""
    robot: Annotated[Path, tyro.conf.arg(metavar="FILE.xml")]
    """MJCF of the robot; its kinematics must be right, its masses need not"""
    out: Annotated[Path, tyro.conf.arg(metavar="MODEL")]
    """file for the model, .npz"""
    check: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE...")] = ()
    """recordings without contact to set thresholds by; else the last 30 % of each of the others"""
    kind: Literal["PP", "SP", "FC"] = "FC"
    """parametric, semi-parametric, or with friction compensated at rest"""
    quiet_speed: float = 1e-2
    """below which a joint is quasi-static [rad/s or m/s]"""
    points: int = 1500
    """samples that the model keeps"""
    columns: options.Columns = ()
    """what the files call their columns, where it differs; also separated by commas"""
    dt: Annotated[float | None, options.optional("FLOAT", "that of the first recording")] = None
    """sampling time of the model and of what it will watch [s]"""
    limits: LimitOptions = field(default_factory=ThresholdConfig)

    def __call__(self) -> int:
        options.use_one_thread()
        from mcpilco.identification import RigidBody, collision
        from mcpilco.mjcf import load_mjcf
        from mcpilco.recordings import sampling_time

        if self.points < 100:
            raise InputError(f"--points must be at least 100, got {self.points}; try 1500.")
        robot = load_mjcf(self.robot, "--robot must be an MJCF file")
        body = RigidBody.of(robot, collision.CURRENT_TERMS)
        joints, named = body.chain.joints, options.column_names(self.columns)
        free = _read(self.recordings, joints, named, self.dt)
        dt = sampling_time(free[0].time) if self.dt is None else self.dt
        config = collision.CurrentConfig(self.kind, self.quiet_speed, points=self.points)
        train, held = _samples(free, config.window, 1.0 if self.check else 1.0 - HELD_OUT)
        if self.check:
            held, _ = _samples(_read(self.check, joints, named, dt), config.window)
        model, report = collision.fit_currents(train, body, dt, config)
        limits = collision.thresholds(model, held, self.limits)
        collision.save_collision_model(self.out, model, limits)
        print(f"Learned from {len(train)} samples, thresholds from {len(held)}.")
        _print_fit(model, held, limits)
        options.warn(*report.warnings)
        if not report.converged:
            options.warn("the fit was stopped before it converged.")
        print(f"Model: {self.out}")
        return 0


@dataclass(frozen=True)
class Threshold(options.Command):
    """Set the thresholds of a model anew, from recordings without any contact."""

    model: ModelPath
    """file of `mcpilco collisions learn`, which is rewritten"""
    recordings: options.Files
    """without contact, and others than those that it was learned from"""
    columns: options.Columns = ()
    """what the files call their columns, where it differs"""
    limits: LimitOptions = field(default_factory=ThresholdConfig)

    def __call__(self) -> int:
        options.use_one_thread()
        from mcpilco.identification import collision

        model, _ = collision.load_collision_model(self.model)
        read = _read(self.recordings, model.joints, options.column_names(self.columns), model.dt)
        held, _ = _samples(read, model.config.window)
        limits = collision.thresholds(model, held, self.limits)
        collision.save_collision_model(self.model, model, limits)
        _print_fit(model, held, limits)
        return 0


@dataclass(frozen=True)
class Detect(options.Command):
    """Find collisions in recordings, as a detector would while they were made."""

    model: ModelPath
    """file of `mcpilco collisions learn`"""
    recordings: options.Files
    """to search; columns push_x, push_y, push_z of a simulation are the truth"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for collisions.json and, of each recording, a table (.csv) and a film (.rrd)"""
    columns: options.Columns = ()
    """what the files call their columns, where it differs"""

    def __call__(self) -> int:
        options.use_one_thread()
        import numpy as np

        from mcpilco.files import make_folder, write_bytes
        from mcpilco.identification.collision import detect, events, load_collision_model
        from mcpilco.recordings import arm_samples
        from mcpilco.show import write_collision_film

        model, limits = load_collision_model(self.model)
        read = _read(self.recordings, model.joints, options.column_names(self.columns), model.dt)
        files = [f"{one.name}{suffix}" for one in read for suffix in (".rrd", ".csv")]
        make_folder(self.out, "collisions.json", *files)
        told: dict[str, Any] = {}
        for recording in read:
            samples = arm_samples(recording, model.config.window)
            found = detect(model, limits, samples)
            alarms = events(found, model.joints)
            push = None
            if recording.force is not None:
                push = recording.force[np.searchsorted(recording.time, samples.time)]
            film = self.out / f"{recording.name}.rrd"
            chain = model.features.body.chain
            write_collision_film(film, recording.name, chain, samples, found, alarms, push)
            write_bytes(self.out / f"{recording.name}.csv", _table(found, model.joints))
            told[recording.name] = [vars(event) for event in alarms]
            _print_alarms(recording.name, alarms)
            if push is not None:
                _print_pushes(found, push)
        write_bytes(self.out / "collisions.json", json.dumps(told, indent=1).encode())
        first = next(iter(told))
        print(f"Look at it with: mcpilco view {self.out / first}.rrd")
        return 0


@dataclass(frozen=True)
class Collisions(options.Command):
    """Find collisions of an arm in its motor currents, without other sensors."""

    command: tyro.conf.OmitArgPrefixes[
        tyro.conf.OmitSubcommandPrefixes[Simulate | Learn | Threshold | Detect]
    ]

    def __call__(self) -> int:
        return self.command()


# Reading ------------------------------------------------------------------------------------------


def _read(
    paths: Sequence[Path], joints: Sequence[str], columns: dict[str, str], dt: float | None
) -> list[ArmRecording]:
    """The recordings, all at one sampling time; remarks go to stderr."""
    from mcpilco.recordings import read_arm, sampling_time

    if not paths:
        raise InputError("name at least one recording.")
    stems = [path.stem for path in paths]
    if len(set(stems)) < len(stems):
        raise InputError("recordings must have different names; rename one of them.")
    found: list[ArmRecording] = []
    for path in paths:
        found.append(read_arm(path, joints, columns, dt))
        dt = sampling_time(found[0].time) if dt is None else dt
        options.warn(*found[-1].remarks, about=path.stem)
    return found


def _samples(
    recordings: Sequence[ArmRecording], window: int, share: float = 1.0
) -> tuple[ArmSamples, ArmSamples]:
    """The beginnings of the recordings, by the share of their samples, and their ends."""
    from mcpilco.recordings import ArmSamples, arm_samples

    parts = [arm_samples(recording, window) for recording in recordings]
    halves = [(part[: (end := round(share * len(part)))], part[end:]) for part in parts]
    begun, ended = zip(*halves, strict=True)
    return ArmSamples.joined(begun), ArmSamples.joined(ended)


# Printing and tables ------------------------------------------------------------------------------


def _print_fit(model: CurrentModel, held: ArmSamples, limits: Thresholds) -> None:
    """The errors on the samples that thresholds were set by, and these."""
    import numpy as np

    residual, still = held.i - model.mean(held), model.quiet(held)
    told = {}
    for name, rows in (("in motion", ~still), ("at rest", still)):
        count = np.maximum(rows.sum(axis=0), 1)
        told[f"Error {name} [A]"] = np.sqrt((residual**2 * rows).sum(axis=0) / count)
    unit = "A" if limits.config.rule == "current" else "std"
    if limits.config.by_phase:
        told[f"Thresholds in motion [{unit}]"] = limits.moving
        told[f"Thresholds at rest [{unit}]"] = limits.resting
    else:
        told[f"Thresholds [{unit}]"] = limits.moving
    for what, values in told.items():
        shown = (f"{j} {value:.3g}" for j, value in zip(model.joints, values, strict=True))
        print(f"{what}: {', '.join(shown)}")


def _print_alarms(name: str, alarms: Sequence[Event]) -> None:
    print(f"{name}: {len(alarms)} alarms")
    for event in alarms:
        where = "at rest" if event.resting else "in motion"
        print(
            f"  {event.start_s:8.3f} s to {event.end_s:8.3f} s, {where}: "
            f"{', '.join(event.joints)}, {event.excess:.1f} thresholds"
        )


def _print_pushes(found: Detection, push: np.ndarray) -> None:
    """Which of the true pushes were found, and when."""
    import numpy as np

    from mcpilco.recordings import runs

    spans = runs(np.abs(push).max(axis=1) > 0.0)
    hits = 0
    for start, end in spans:
        at = np.flatnonzero(found.collision[start:end])
        force = float(np.linalg.norm(push[start:end], axis=1).max())
        told = "missed"
        if len(at):
            told = f"found after {1000 * (found.time[start + at[0]] - found.time[start]):.0f} ms"
        hits += bool(len(at))
        print(f"  push at {found.time[start]:.3f} s, {force:.0f} N: {told}")
    print(f"  {hits} of {len(spans)} pushes found")


def _table(found: Detection, joints: Sequence[str]) -> bytes:
    """The output of the detector as a CSV, a row a sample."""
    import numpy as np

    from mcpilco.files import csv_bytes

    kinds = ("expected", "residual", "threshold", "joints")
    names = ["time", *(f"{j}_{k if k != 'joints' else 'alarm'}" for k in kinds for j in joints)]
    arrays = np.hstack([getattr(found, kind).astype(float) for kind in kinds])
    return csv_bytes(names, np.round(np.column_stack([found.time, arrays]), 6).tolist())


def _pushes(targets: Any, friction: float, rng: np.random.Generator) -> tuple[Any, ...]:
    """A push in every other move and in every other rest, of three strengths."""
    from envs.arms.sticky_arm import Push

    found = []
    for number, move in enumerate(targets.moves):
        resting = number % 2 == 1
        start = move.end_s + 0.5 if resting else 0.5 * (move.start_s + move.end_s)
        strength = (1.0, 2.0, 3.0)[number // 2 % 3] * float(rng.choice([-1.0, 1.0]))
        found.append(Push(start, strength * friction))
    return tuple(found)
