"""What `mcpilco gap` finds in recordings of five real machines, in every direction of holding out.

    python runs/real_machines/run.py --data FOLDER
    python runs/real_machines/run.py --data FOLDER --stability    # do the names come back?

FOLDER holds a folder of recordings for each machine; README.md says which. Results are kept in
results/, a file a question, and in stability/, a file a machine; the same command goes on where it
was stopped, and rewrites README.md between its marked lines.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1]))  # what runs share, wherever it is run from

from harness import code_that_made, fill, keep, use_one_thread
from real_machines.machines import MACHINES

from mcpilco.gap import Gap, investigate, repetitions, to_json
from mcpilco.logbook import read_json
from mcpilco.sweep import machine, markdown

HERE = Path(__file__).parent
MODELS = "nominal", "refit", "corrected"
EARLY_S = 0.5
"""after the start of a free run, at which errors are told besides [s]"""
OFTEN = 0.9
"""part of the repetitions in which a name should come back [-]"""


@dataclass(frozen=True)
class Arguments:
    """Look for what is missing in the models of real machines."""

    data: Path | None = None
    """folder of the machines' folders; by default the one that MCPILCO_DATA names"""
    machines: tuple[Literal[*MACHINES], ...] = tuple(MACHINES)
    """which of them"""
    stability: bool = False
    """ask but one question of each machine, and again without parts of its recordings"""
    only_tables: bool = False
    """run nothing: write the tables of the results that are there"""
    workers: int = 2
    """processes at a time"""
    out: Path = HERE
    """folder of results/, stability/ and README.md"""


@dataclass(frozen=True)
class Question:
    """What is asked of a machine's recordings."""

    machine: str
    held_out: str
    """name of the recordings that no fit may see"""
    dt_ms: float
    """sampling time at which motions are compared [ms]"""

    @property
    def file(self) -> str:
        """Under results/."""
        return f"{self.machine}/{self.held_out.replace(' ', '_')}_{self.dt_ms:g}ms.json"

    @classmethod
    def repeated(cls, machine: str) -> Question:
        """The one that is asked again without parts of a machine's recordings."""
        told = MACHINES[machine]
        return cls(machine, told.repeated or next(iter(told.held_out)), told.dts_ms[0])


def questions(machines: tuple[str, ...] = tuple(MACHINES)) -> Iterator[Question]:
    """All of some machines; other sampling times than the first are asked of one hold-out."""
    for name in machines:
        asked = MACHINES[name]
        for number, held_out in enumerate(asked.held_out):
            for dt_ms in asked.dts_ms if number == 0 else asked.dts_ms[:1]:
                yield Question(name, held_out, dt_ms)


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    if not arguments.only_tables:
        run(arguments)
    write_readme(arguments.out)
    print(f"Tables: {arguments.out / 'README.md'}")
    return 0


def run(arguments: Arguments) -> None:
    """Asks what has no result yet, and keeps each as soon as it is there."""
    data = arguments.data or Path(os.environ.get("MCPILCO_DATA", "."))
    if missing := [name for name in arguments.machines if not (data / name).is_dir()]:
        raise SystemExit(f"--data must hold a folder of each machine, {data} has no {missing[0]}.")
    asked: dict[Path, Question]
    if arguments.stability:
        folder, how = arguments.out / "stability", repeat
        asked = {Path(f"{name}.json"): Question.repeated(name) for name in arguments.machines}
    else:
        folder, how = arguments.out / "results", solve
        asked = {Path(each.file): each for each in questions(arguments.machines)}
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(arguments.workers, context) as pool:
        waiting = {
            pool.submit(_timed, how, each, data): path
            for path, each in asked.items()
            if not (folder / path).exists()
        }
        for done in as_completed(waiting):
            path, found = waiting[done], done.result()
            keep(folder / path, found, HERE.name)
            told = found["names"] if arguments.stability else found["effects"]
            names = [f"{e['name']} ({e['target']})" for e in told]
            print(f"{path}: {found['verdict']}, {', '.join(names) or 'no effect'}")


def _timed(
    how: Callable[[Question, Path], dict[str, Any]], asked: Question, data: Path
) -> dict[str, Any]:
    """The answer to a question, with the host that found it and the CPU time that it took."""
    use_one_thread()
    spent = time.process_time()
    found = how(asked, data)
    return found | {"cpu_s": time.process_time() - spent, "host": machine()}


def solve(asked: Question, data: Path) -> dict[str, Any]:
    """The content of `gap.json`, with the errors some time after a free run begins."""
    gap = find(asked, data)
    return to_json(gap) | {"early": _early(gap)}


def repeat(asked: Question, data: Path) -> dict[str, Any]:
    """The content of `stability.json`."""
    gap = find(asked, data)
    told = repetitions(gap, free=MACHINES[asked.machine].free).to_json()
    return {"held_out": asked.held_out, "dt_ms": asked.dt_ms, "verdict": gap.verdict} | told


def find(asked: Question, data: Path) -> Gap:
    """What the workflow says."""
    told = MACHINES[asked.machine]
    recordings = told.recordings(data, asked.dt_ms / 1e3)
    held_out = told.held_out[asked.held_out]
    return investigate(told.plant(), recordings, free=told.free, held_out=held_out)


def _early(gap: Gap) -> dict[str, float]:
    """Errors [noise std] after `EARLY_S`, by model."""
    if gap.comparison is None:
        return {}
    at = round(EARLY_S / gap.comparison.windows.dt)
    return {name: float(gap.comparison.over_time[name][at]) for name in MODELS}


def write_readme(out: Path) -> None:
    """Put the tables of the results that are there into README.md."""
    fill(out / "README.md", page(out), template=HERE / "README.md")


def page(folder: Path) -> list[str]:
    """The parts of the page that results make, and repetitions."""
    results = folder / "results"
    found = {q: read_json(results / q.file) for q in questions() if (results / q.file).exists()}
    if not found:
        return ["Not measured yet."]
    parts = [_origin(found)]
    for name in MACHINES:
        own = {q: told for q, told in found.items() if q.machine == name}
        if own:
            parts += [f"### {name}", _effects_table(own), _errors_table(own)]
    paths = [folder / "stability" / f"{name}.json" for name in MACHINES]
    repeated = {path.stem: read_json(path) for path in paths if path.exists()}
    if repeated:
        parts += ["### Do the names come back?", _stability_table(repeated)]
    return parts


def _stability_table(repeated: dict[str, dict[str, Any]]) -> str:
    """How often each name came back, and how many did nearly always."""
    rows, back = [], []
    for name, told in repeated.items():
        runs = len(told["repetitions"])
        own = name, told["held_out"], told["verdict"], str(runs)
        lines = [
            (f"{e['name']} ({e['target']})", str(e["count"]), str(e["alike"]), "")
            for e in told["names"]
        ]
        lines += [(f"instead: {other}", "", "", str(n)) for other, n in told["instead"].items()]
        lines = lines or [("-", "", "", "")]
        rows += [(*own, *lines[0]), *(("", "", "", "", *line) for line in lines[1:])]
        back += [e["alike"] / runs for e in told["names"]]
    header = (
        "machine",
        "held out",
        "verdict",
        "repetitions",
        "name",
        "came back",
        "or fits",
        "instead",
    )
    often = sum(part >= OFTEN for part in back)
    said = (
        "A question of each of these machines, asked again without each of its fitted recordings, "
        f"with every second sample, and without the first half second. {often} of {len(back)} "
        f"names come back in at least {100 * OFTEN:.0f} % of the repetitions, by themselves or by "
        "another name of their family (`or fits` counts both)."
    )
    return f"{said}\n\n{markdown(header, rows)}"


def _origin(found: dict[Question, dict[str, Any]]) -> str:
    seconds = np.median([told["cpu_s"] for told in found.values()])
    asked = Counter(map(code_that_made, found.values())).most_common()
    return (
        f"{len(found)} questions, a median of {seconds:.0f} CPU seconds each, on one thread; "
        f"{'; '.join(f'{count} with {code}' for code, count in asked)}."
    )


def _effects_table(found: dict[Question, dict[str, Any]]) -> str:
    rows = []
    for asked, told in found.items():
        own = (asked.held_out, f"{asked.dt_ms:g}", told["verdict"])
        left = ", ".join(f"{f['std']:.3g} {f['unit']} ({f['joint']})" for f in told["left"])
        effects = [_effect_cells(each) for each in told["effects"]]
        if told["closest"]:
            effects = [_effect_cells(each, "closest: ") for each in told["closest"]["effects"]]
        effects = effects or [("-", "", "", "")]
        rows += [(*own, *effects[0], left), *(("", "", "", *cells, "") for cells in effects[1:])]
    header = (
        "held out",
        "dt [ms]",
        "verdict",
        "effect",
        "95 % interval",
        "share [%]",
        "probability [%]",
        "force left",
    )
    return markdown(header, rows)


def _effect_cells(effect: dict[str, Any], before: str = "") -> tuple[str, ...]:
    values = [
        f"{symbol} = {e['value']:.4g} {e['unit']} ({e['low']:.4g} to {e['high']:.4g})"
        for symbol, e in effect["parameters"].items()
    ]
    alike = effect["family"][1:]
    name = f"{before}{effect['name']} ({effect['target']})" + (
        f" or {', '.join(alike)}" if alike else ""
    )
    return (
        name,
        ", ".join(values),
        f"{100 * effect['share']:.0f}",
        f"{100 * effect['probability']:.0f}",
    )


def _errors_table(found: dict[Question, dict[str, Any]]) -> str:
    """Free runs on the recordings that no fit has seen."""
    rows = []
    for asked, told in found.items():
        error = told["error"]
        if error is None:
            continue
        for state, by_model in error["channels"].items():
            unit = error["units"][state]
            cells = [f"{by_model[model]:.3g}" for model in (*MODELS, "noise_floor")]
            rows.append((asked.held_out, f"{asked.dt_ms:g}", f"{state} [{unit}]", *cells, ""))
        for label, errors in (("mean", error), (f"mean after {EARLY_S:g} s", told["early"])):
            best = min(errors["nominal"], errors["refit"])
            cells = [f"{errors[model]:.3g}" for model in MODELS]
            floor = f"{error['noise_floor']:.3g}" if label == "mean" else ""
            below = f"{100 * (1 - errors['corrected'] / best):.0f}"
            rows.append(
                (asked.held_out, f"{asked.dt_ms:g}", f"{label} [noise std]", *cells, floor, below)
            )
    header = (
        "held out",
        "dt [ms]",
        "error of",
        *MODELS,
        "noise floor",
        "below the better of nominal and refit [%]",
    )
    horizons = {told["error"]["horizon_s"] for told in found.values() if told["error"]}
    spans = " or ".join(f"{seconds:g} s" for seconds in sorted(horizons))
    return f"Free runs of {spans}, rms at their end:\n\n{markdown(header, rows)}"


if __name__ == "__main__":
    sys.exit(main())
