"""`mcpilco gap`: where a simulation and recordings disagree, and which effect is missing."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mcpilco.cli.options import (
    Columns,
    Command,
    Files,
    column_names,
    make_folder,
    named_numbers,
    optional,
    register,
    separated,
    uncertainty,
    use_one_thread,
    without,
)
from mcpilco.config import CART_POLE

if TYPE_CHECKING:
    from mcpilco.gap import Gap as Investigated
    from mcpilco.plant import Plant


@dataclass(frozen=True)
class Gap(Command):
    """Find where a plant and recordings disagree, name the missing effect, add it."""

    recordings: Files
    """CSV, npz or parquet, with the columns `time`, the plant's states and inputs"""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder for gap.json, corrected.json (of an MJCF corrected.xml), report.html and gap.rrd"""
    plant: Annotated[str, tyro.conf.arg(metavar="ID|FILE.xml")] = CART_POLE
    """a registered plant, or an MJCF file; `module:Id` imports the module first"""
    columns: Columns = ()
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
        """Investigate, and return the exit code."""
        use_one_thread()
        register("" if self.plant.endswith(".xml") else self.plant)
        from mcpilco.gap import investigate, write_json
        from mcpilco.plant import correction_of, write_correction
        from mcpilco.recordings import read_for_plant

        plant = self._plant()
        recordings, notes = read_for_plant(
            plant, self.recordings, column_names(self.columns), self.dt
        )
        for note in notes:
            print(note, file=sys.stderr)
        gap = investigate(
            plant,
            recordings,
            uncertainty=uncertainty(self.uncertainty),
            free=tuple(separated(self.free)),
            noise=named_numbers("--noise", self.noise),
            held_out=tuple(separated(self.held_out)),
            effects=self.effects,
        )
        make_folder(self.out)
        write_json(gap, self.out / "gap.json")
        written = ["gap.json"]
        if gap.verdict != "too_poor":
            correction = correction_of(gap.corrected, plant)
            write_correction(self.out / "corrected.json", correction)
            written.append("corrected.json")
            if Path(self.plant).suffix == ".xml":
                written += self._write_mjcf(gap)
        show_gap(gap, self.out, written)
        return 0

    def _write_mjcf(self, gap: Investigated) -> list[str]:
        """The corrected model, where it can be written; says what MJCF cannot say of it."""
        from mcpilco.plant import correction_of, plant_of, write_corrected_mjcf

        path = self.out / "corrected.xml"
        correction = correction_of(gap.corrected, plant_of(self.plant))
        with without("corrected.xml"):
            for sentence in write_corrected_mjcf(self.plant, correction, path):
                print(f"Not in corrected.xml: {sentence}")
            return [path.name]
        return []

    def _plant(self) -> Plant:
        from envs import plant_named

        plant = plant_named("--plant", self.plant)
        return plant.where(**named_numbers("--set", self.set))


def show_gap(gap: Investigated, out: Path, written: Sequence[str]) -> None:
    """Print the summary of an investigation, and draw its page and film.

    Args:
        gap: the investigation.
        out: folder of its files.
        written: which are there already. What cannot be drawn loses nothing else.
    """
    from mcpilco.gap import summary
    from mcpilco.show import write_gap_film
    from mcpilco.show.report import write_gap_report

    for line in summary(gap):
        print(line)
    written = list(written)
    with without("all pictures"):
        if gap.comparison is not None:
            written.append(write_gap_film(gap, out / "gap.rrd").name)
        written.append(write_gap_report(gap, out / "report.html").name)
    print(f"In {out}: {', '.join(written)}.")
    if "gap.rrd" in written:
        print(f"Look at it with: mcpilco view {out}")
