"""Which results are of the code that is here.

A result that is kept says by which code it was made (`made`: digest and commit), on what machine,
and whether anything had been chosen on its seed before. `state_of` compares the digest with that of
the code that is here.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal

from all_tables import TABLES, Table
from provenance import COMMIT, RUNS, Code, edited

from mcpilco.sweep import machine

State = Literal["current", "confirmed", "stale", "unknown"]
"""of a result: of the code that is here; of code whose sample this code made again (`again.py`); of
other code; of code that is not recorded"""


SAMPLES = "again.json"
"""file of a run that says which of its results were made again"""


@dataclass(frozen=True)
class Finding:
    """How many results of a table are of the code that is here, and of other code."""

    table: Table
    states: Mapping[State, int]
    """how many results"""
    changed: tuple[str, ...]
    """packages whose code is another since the stale ones were made"""
    made: tuple[str, ...]
    """digests and commits of the code that made them"""

    @property
    def state(self) -> State:
        """Of the table: current only where all its results are."""
        worst: tuple[State, ...] = ("unknown", "stale", "confirmed")
        return next((state for state in worst if self.states.get(state)), "current")


def findings(tables: Sequence[Table] | None = None) -> Iterator[Finding]:
    """The state of each table that has results."""
    for table in TABLES if tables is None else tables:
        states: dict[State, int] = {}
        changed: set[str] = set()
        made: dict[str, None] = {}
        confirmed = confirmed_by(table)
        for path in table.paths():
            told = read_made(path)
            state = state_of(told, table.code, confirmed)
            states[state] = states.get(state, 0) + 1
            if state == "stale":
                changed |= set(table.code.changed(told["parts"]))
            if told.get("digest"):
                made[f"{told['digest']} ({told['commit'] or 'no commit'})"] = None
        if states:
            yield Finding(table, states, tuple(sorted(changed)), tuple(made))


def state_of(
    made: Mapping[str, Any], code: Code, confirmed: Collection[str | None] = frozenset()
) -> State:
    """Whether a result is of this code, or of other code that is confirmed by it."""
    digest = made.get("digest")
    if digest == code.digest:
        return "current"
    if digest in confirmed:
        return "confirmed"
    return "stale" if digest else "unknown"


def confirmed_by(table: Table) -> set[str | None]:
    """The codes, by digest, of which today's code made a sample again; None: code not recorded."""
    samples = read_samples(table.run).get(table.results, {})
    here = [sample for sample in samples.values() if sample["by"] == table.code.digest]
    return {sample["of"] for sample in here}


def read_samples(run: str) -> dict[str, dict[str, Any]]:
    """The samples that `again.py` has confirmed: by table, then by the digest of their code."""
    path = RUNS / run / SAMPLES
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def read_made(path: Path) -> Mapping[str, Any]:
    """The record in a result of the code that made it; empty where there is none.

    A result in a CSV file has a file of the same name beside it.
    """
    about = path if path.suffix == ".json" else path.with_suffix(".json")
    if not about.exists():
        return {}
    found = json.loads(about.read_text(encoding="utf-8"))
    return found.get("made", {}) if isinstance(found, dict) else {}


# What a result says -------------------------------------------------------------------------------


class Stamp:
    """The record of today's code that results of a table are kept with."""

    def __init__(self, table: Table) -> None:
        """Digests the code, which takes some seconds: before the results are made, and once."""
        self._table = replace(table)  # without what it has digested: it is sent to workers
        self._by = {"digest": table.code.digest, "parts": table.code.parts, "commit": COMMIT}
        self._files = table.code.files

    def on(self, found: Mapping[str, Any], path: Path, continued: bool = False) -> dict[str, Any]:
        """A result with its machine, its code and the role of its seed.

        There is no digest where the code was edited on the way, or another has begun the result.

        Args:
            found: the result.
            path: of its file.
            continued: whether it holds what the file that is there held.
        """
        by = {**self._by, "role": self._table.role(path)}
        before = read_made(path).get("digest") if continued else by["digest"]
        if before != by["digest"] or edited(self._files):
            by |= {"digest": None, "parts": {}}
        return {"machine": machine(), **found, "made": by}


@cache
def stamp(table: Table) -> Stamp:
    """That of a table, made once a process."""
    return Stamp(table)
