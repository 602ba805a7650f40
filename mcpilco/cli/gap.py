"""`mcpilco gap`: where a simulation and recordings disagree, and which effect is missing."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from mcpilco.cli import options
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError, McPilcoError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.gap import Gap as Investigated
    from mcpilco.mjcf import Physics
    from mcpilco.plant import Plant
    from mcpilco.recordings import Recording

INTERRUPTED, STABILITY = "interrupted.json", "stability.json"
CALLBACKS = "corrected.py"
FILES = (
    "gap.json",
    STABILITY,
    "corrected.json",
    "corrected.xml",
    CALLBACKS,
    "closest.json",
    "gap.rrd",
    "report.html",
    INTERRUPTED,
)
"""that the command writes"""
MOST_LOST = 0.5
"""part of recordings that equations may leave out, since something is touched there [-]"""
REMEDY = "name another folder, or pass --overwrite"
"""where one is there already"""


@dataclass(frozen=True)
class Gap(options.Command):
    """Find where a plant and recordings disagree, name the missing effect, add it."""

    recordings: options.Files
    """CSV, npz, mat or parquet, with the columns `time`, the plant's states and inputs"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for gap.json, corrected.json (of an MJCF corrected.xml), report.html and gap.rrd"""
    plant: Annotated[str, tyro.conf.arg(metavar="ID|FILE")] = CART_POLE
    """a registered plant, or an MJCF or URDF file; `module:Id` imports the module first"""
    physics: Literal["auto", "equations", "mujoco"] = "auto"
    """who simulates a file: equations where they can say it, or MuJoCo, with contacts and stops"""
    keyframe: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """of the model: the pose of what was not recorded; by default that in which it is drawn"""
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="[FILE:]NAME=COLUMN,...")] = ()
    """what files call time, states and inputs, where it differs, all or FILE; NAME= ignores one"""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE...")] = ()
    """other values of nominal parameters"""
    uncertainty: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STD|NAME=STD...")] = ("0.01",)
    """prior std of masses, lengths, friction and gains, relative to their values; 0 trusts them"""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...|all")] = ()
    """parameters of which nothing is known beforehand"""
    noise: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STATE=STD...")] = ()
    """noise of a state's measurement in its unit; by default it is estimated"""
    held_out: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...")] = ()
    """recordings that no fit may see, without .csv; by default the last ones of three or more"""
    effects: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="FILE.py...")] = ()
    """Python files with effects of your own, which are executed: they are searched for as well"""
    events: Annotated[Path | None, options.optional("FILE.json", "none")] = None
    """collisions.json of `mcpilco collisions detect`: nothing is compared while one lasts"""
    dt: Annotated[float | None, options.optional("FLOAT", "the longest of theirs")] = None
    """sampling time to which all are brought [s]"""
    accept: bool = False
    """go on with recordings that look wrong, such as a torque in mN m; the verdict says so first"""
    stability: bool = False
    """repeat it without each recording, thinned, and begun later: say which names come back"""
    overwrite: bool = False
    """replace what an earlier run has left in the folder"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        """Investigate, and return the exit code."""
        options.use_one_thread()
        options.register("" if options.is_model(self.plant) else self.plant)
        stages = Stages()
        try:
            with stages.shown(self.quiet):
                return self._investigate(stages)
        except KeyboardInterrupt:
            print(f"mcpilco: interrupted; {self._kept(stages)}", file=sys.stderr)
            return 130

    def _investigate(self, stages: Stages) -> int:
        from mcpilco.files import make_folder, write_bytes
        from mcpilco.gap import investigate, repetitions, write_json
        from mcpilco.plant import correction_of, write_correction
        from mcpilco.recordings import misreadings, require_plausible

        if not self.overwrite:
            options.require_new(*(self.out / name for name in FILES), remedy=REMEDY)
        nominal, plant, recordings = self._read(self.physics)
        stages.begin("check of the recordings")
        doubts = misreadings(plant, recordings, self._limits(plant))
        if not self.accept:
            require_plausible(doubts)
        make_folder(self.out, *FILES)
        for name in FILES:
            (self.out / name).unlink(missing_ok=True)
        how: dict[str, Any] = {
            "uncertainty": options.uncertainty(self.uncertainty),
            "free": tuple(options.separated(self.free)),
            "noise": options.named_numbers("--noise", self.noise),
            "effects": self.effects,
            "accepted": doubts,
        }
        held_out = tuple(options.separated(self.held_out))
        gap = investigate(plant, recordings, held_out=held_out, **how)
        write_json(gap, self.out / "gap.json")
        written = ["gap.json"]
        if gap.verdict != "too_poor":
            corrections = {"corrected.json": gap.correction}
            if gap.closest is not None:
                corrections["closest.json"] = correction_of(gap.closest.plant, plant)
            for name, correction in corrections.items():
                write_correction(self.out / name, correction)
            written += corrections
            if options.is_model(self.plant):
                written += self._write_mjcf(gap, nominal)
        if self.stability:
            stages.begin("repetitions")
            repeated = repetitions(gap, **how)
            text = json.dumps(repeated.to_json(), indent=2)
            write_bytes(self.out / STABILITY, text.encode())
            written.append(STABILITY)
        code = show_gap(gap, self.out, written, stages.begin)
        if self.stability:
            print(*repeated.summary(), sep="\n")
        return code

    def _read(self, physics: Physics) -> tuple[Plant, Plant, list[Recording]]:
        """The plant, as it is and with `--set`, and the recordings; says who simulates a file."""
        from envs import plant_named
        from mcpilco.recordings import read_for_plant

        auto = physics == "auto" and options.is_model(self.plant) and not self.keyframe
        first: Physics = "equations" if auto else physics  # what could touch may never do so
        try:
            nominal = plant_named("--plant", self.plant, physics=first, keyframe=self.keyframe)
        except InputError:
            if not auto:
                raise
            return self._read("mujoco")
        plant = nominal.where(**options.named_numbers("--set", self.set))
        recordings, notes = read_for_plant(
            plant,
            self.recordings,
            options.column_maps(self.columns),
            self.dt,
            None if self.events is None else options.spans_of(self.events),
        )
        if options.is_model(self.plant):
            if not plant.timestep_s:
                free, lost = self._touching_nothing(plant, recordings)
                enough = lost <= MOST_LOST
                if lost:
                    said = "left out" if enough else "MuJoCo is taken" if auto else "kept"
                    where = f"In {lost:.0%} of the recordings the machine touches something"
                    print(f"{where}, which no equation has: {said}.", file=sys.stderr)
                if auto and not enough:
                    return self._read("mujoco")
                recordings = free if enough else recordings
            print(f"{plant.name} is simulated by {plant.simulated_by}.", file=sys.stderr)
        for note in notes:
            print(note, file=sys.stderr)
        return nominal, plant, recordings

    def _touching_nothing(
        self, plant: Plant, recordings: Sequence[Recording]
    ) -> tuple[list[Recording], float]:
        """Recordings with gaps where bodies touch or joints are at ends, and the part so lost."""
        from mcpilco.mjcf import spans_touching

        free = []
        for one in recordings:
            positions = dict(zip(plant.layout.joints, one.states[:, 0::2].T, strict=True))
            spans = spans_touching(self.plant, one.time, positions)
            free.append(one.without(spans) if spans else one)
        before, left = (sum(map(_followed_s, each)) for each in (recordings, free))
        return free, 1.0 - left / before if before else 0.0

    def _write_mjcf(self, gap: Investigated, nominal: Plant) -> list[str]:
        """The corrected model, where it can be written; says what MJCF cannot say of it."""
        from mcpilco.mjcf import write_corrected_mjcf
        from mcpilco.plant import correction_of

        path = self.out / "corrected.xml"
        with options.without("corrected.xml"):
            correction = correction_of(gap.corrected, nominal)
            for sentence in write_corrected_mjcf(self.plant, correction, path, nominal):
                print(f"Not in corrected.xml: {sentence}")
            return [name for name in (path.name, CALLBACKS) if (self.out / name).exists()]
        return []

    def _kept(self, stages: Stages) -> str:
        """Write what an interrupted run knows; returns a sentence on what is there."""
        there = [name for name in FILES if (self.out / name).exists()]
        if stages.stage.startswith("drawing"):
            return f"{self.out} holds {', '.join(there)}, and nothing was drawn after them."
        if not self.out.is_dir() or not stages.done:
            return "nothing was found yet, and nothing is written."
        from mcpilco.files import write_bytes

        known = {"format": 1, "ended": stages.done, "interrupted_in": stages.stage}
        write_bytes(self.out / INTERRUPTED, json.dumps(known, indent=2).encode())
        effects = ", ".join(stages.done[-1]["effects"]) or "none"
        return (
            f"{len(stages.done)} stages had ended, which {self.out / INTERRUPTED} lists; effects "
            f"known by then: {effects}. There is no verdict."
        )

    def _limits(self, plant: Plant) -> list[float]:
        """The largest command that each actuator of the plant's env takes; none without an env."""
        import gymnasium

        if plant.name not in gymnasium.registry:
            return []
        with contextlib.closing(gymnasium.make(plant.name, disable_env_checker=True)) as env:
            actions: Any = env.action_space
            return [float(high) for high in actions.high]


def _followed_s(recording: Recording) -> float:
    """For how long a recording can be followed, between its gaps [s]."""
    from mcpilco.gap import DATA

    stretches = [recording.dt * (part.stop - part.start) for part in recording.segments()]
    return sum(s - DATA.past_s for s in stretches if s > DATA.past_s + DATA.window_s)


def show_gap(
    gap: Investigated,
    out: Path,
    written: Sequence[str],
    begin: Callable[[str], None] = lambda stage: None,
) -> int:
    """Print the summary of an investigation, draw its page and film, and return the exit code.

    What cannot be drawn loses nothing else. `begin` is called with the name of each stage.
    """
    from mcpilco.gap import summary
    from mcpilco.show import write_gap_film
    from mcpilco.show.report import write_gap_report

    for line in summary(gap):
        print(line)
    written, code = list(written), 0
    drawn = {"gap.rrd": write_gap_film} if gap.comparison is not None else {}
    for name, write in {**drawn, "report.html": write_gap_report}.items():
        begin(f"drawing of {name}")
        try:
            written.append(write(gap, out / name).name)
        except McPilcoError as error:
            options.warn(f"without {name}: {error}")
            code = max(code, int(isinstance(error, RunFolderError)))  # not where an extra lacks
    begin("")
    print(f"In {out}: {', '.join(written)}.")
    if "gap.rrd" in written:
        print(f"Look at it with: mcpilco view {out}")
    return code


class Stages(logging.Handler):
    """The stages of an investigation, as it logs them, with the time that each has taken."""

    def __init__(self) -> None:
        super().__init__()
        self.done: list[dict[str, Any]] = []
        """name, seconds [s] and the effects that were known when it ended"""
        self.stage = ""
        """the present one"""
        self._since = 0.0
        self._bar: Any = None

    def emit(self, record: logging.LogRecord) -> None:
        self.begin(record.getMessage(), getattr(record, "found", ()))

    def begin(self, name: str, found: Sequence[str] = ()) -> None:
        """End the present stage, and begin another; the empty name begins none."""
        now, bar = time.monotonic(), self._bar
        for task in bar.task_ids if bar else ():
            bar.remove_task(task)
        if self.stage:
            seconds = round(now - self._since, 1)
            self.done.append({"stage": self.stage, "seconds": seconds, "effects": list(found)})
            if bar:
                line = f"{self.stage}: {seconds:.1f} s"
                bar.console.print(line, highlight=False, soft_wrap=True)
        self.stage, self._since = name, now
        if name and bar:
            bar.add_task(name)

    @contextlib.contextmanager
    def shown(self, quiet: bool) -> Iterator[None]:
        """Listen to an investigation, and show its stages: on a terminal with a running clock."""
        from rich.console import Console
        from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        console = Console(stderr=True, quiet=quiet)
        moving = console.is_terminal and not quiet
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        log = logging.getLogger("mcpilco.gap")
        level = log.level
        with Progress(*columns, console=console, disable=not moving, transient=True) as self._bar:
            log.addHandler(self)
            log.setLevel(logging.INFO)
            try:
                yield
            finally:
                log.removeHandler(self)
                log.setLevel(level)
