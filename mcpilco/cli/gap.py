"""`mcpilco gap`: where a simulation and recordings disagree, and which effect is missing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mcpilco.cli.options import optional
from mcpilco.cli.pairs import named_numbers, number, pairs, separated
from mcpilco.cli.system import use_one_thread
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError, McPilcoError

if TYPE_CHECKING:
    from mcpilco.gap import Gap as Investigated
    from mcpilco.plant import Plant
    from mcpilco.recordings import Recording


@dataclass(frozen=True)
class Gap:
    """Find where a plant and recordings disagree, name the missing effect, add it."""

    recordings: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE...")]
    """CSV, npz or parquet, with the columns `time`, the plant's states and inputs"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for gap.json, corrected.json (of an MJCF corrected.xml), report.html and gap.rrd"""
    plant: Annotated[str, tyro.conf.arg(metavar="ID|FILE.xml")] = CART_POLE
    """id of an env, or an MJCF file"""
    columns: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=COLUMN...")] = ()
    """what the files call time, states and inputs, where it differs; also separated by commas"""
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
    dt: Annotated[float | None, optional("FLOAT", "the longest of theirs")] = None
    """sampling time to which all are brought [s]"""

    def __call__(self) -> int:
        """Investigate, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        use_one_thread()
        from mcpilco.gap import investigate
        from mcpilco.gap.report import summary, write_json
        from mcpilco.plant import correction_of, write_correction

        plant = self._plant()
        recordings = self._read(plant)
        uncertainty = self._uncertainty()
        gap = investigate(
            plant,
            recordings,
            uncertainty=uncertainty,
            free=tuple(name for entry in self.free for name in entry.split(",")),
            noise=named_numbers("--noise", self.noise),
            held_out=tuple(name for entry in self.held_out for name in entry.split(",")),
            effects=self.effects,
        )
        self.out.mkdir(parents=True, exist_ok=True)
        write_json(gap, self.out / "gap.json")
        written = ["gap.json"]
        if gap.verdict != "too_poor":
            correction = correction_of(gap.corrected, plant)
            write_correction(self.out / "corrected.json", correction)
            written.append("corrected.json")
            if Path(self.plant).suffix == ".xml":
                written += self._write_mjcf(gap)
        for line in summary(gap):
            print(line)
        written += self._draw(gap)
        print(f"In {self.out}: {', '.join(written)}.")
        if "gap.rrd" in written:
            print(f"Look at it with: mcpilco view {self.out}")
        return 0

    def _write_mjcf(self, gap: Investigated) -> list[str]:
        """The corrected model, where it can be written; says what MJCF cannot say of it."""
        from mcpilco.plant import correction_of, plant_of, write_corrected_mjcf

        path = self.out / "corrected.xml"
        correction = correction_of(gap.corrected, plant_of(self.plant))
        try:
            left = write_corrected_mjcf(self.plant, correction, path)
        except McPilcoError as error:
            print(f"mcpilco: without corrected.xml: {error}", file=sys.stderr)
            return []
        for sentence in left:
            print(f"Not in corrected.xml: {sentence}")
        return [path.name]

    def _draw(self, gap: Investigated) -> list[str]:
        """The files of pictures that are written; what cannot be drawn loses nothing else."""
        from mcpilco.show.gap_film import write_film
        from mcpilco.show.report.gap_page import write_gap_report

        written = []
        try:
            if gap.comparison is not None:
                written.append(write_film(gap, self.out / "gap.rrd").name)
            written.append(write_gap_report(gap, self.out / "report.html").name)
        except McPilcoError as error:
            print(f"mcpilco: without all pictures: {error}", file=sys.stderr)
        return written

    def _plant(self) -> Plant:
        if Path(self.plant).suffix == ".xml":
            from mcpilco.plant import plant_of

            plant = plant_of(self.plant)
        else:
            from envs import PLANTS

            if self.plant not in PLANTS:
                raise InputError(
                    f"--plant must be one of {', '.join(PLANTS)} or an MJCF file, "
                    f"got {self.plant!r}."
                )
            plant = PLANTS[self.plant]()
        return plant.where(**named_numbers("--set", self.set))

    def _read(self, plant: Plant) -> list[Recording]:
        """The recordings that can be read, at one sampling time; says what is wrong with others."""
        good = self._readable(plant, self.recordings, self.dt)
        steps = {round(recording.dt, 9) for recording in good}
        if len(steps) > 1:
            names = {recording.name for recording in good}
            paths = [path for path in self.recordings if path.stem in names]
            longest = max(steps)
            good = self._readable(plant, paths, longest)
            told = ", ".join(f"{step:g}" for step in sorted(steps))
            print(
                f"sampling times are {told} s: all are read at {longest:g} s (--dt names another).",
                file=sys.stderr,
            )
        for recording in good:
            for remark in recording.remarks:
                print(f"{recording.name}: {remark}", file=sys.stderr)
        return good

    def _readable(self, plant: Plant, paths: Sequence[Path], dt: float | None) -> list[Recording]:
        from mcpilco.recordings import read_recordings

        states = plant.layout.states
        good, bad = read_recordings(
            paths,
            states,
            plant.layout.inputs,
            angles=plant.angles,
            velocities=tuple((k, k + 1) for k in range(0, len(states), 2)),
            columns=dict(pairs("--columns", separated(self.columns))),
            dt=dt,
        )
        for error in bad:
            print(f"left out: {error}", file=sys.stderr)
        if not good:
            raise InputError("none of the recordings can be read; mend one of the faults above.")
        return good

    def _uncertainty(self) -> float | dict[str, float]:
        plain = [entry for entry in self.uncertainty if "=" not in entry]
        named = named_numbers("--uncertainty", [e for e in self.uncertainty if "=" in e])
        if named:
            return named
        return number("--uncertainty", plain[-1])
