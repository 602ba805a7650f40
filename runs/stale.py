"""Which tables of runs/ are of other code than is here, and which of code that nobody knows.

    python runs/stale.py                           # says nothing where there is none
    python runs/stale.py --all                     # tells the others too
    python runs/stale.py --runs limits --check     # exits with 1 where a table of a run is one

A table is `current` where all its results have the digest of the code that is here, `confirmed`
where this code made a sample of the others again and they were equal (`again.py`), `stale` where
one has another digest (the packages that differ stand behind it), `unknown` where one has none: it
was made before digests were kept, or by code of several versions. What has no results is not
listed.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import tyro

sys.path.append(str(Path(__file__).parent))

from all_tables import TABLES, named
from evidence import Finding, State, findings
from provenance import git


@dataclass(frozen=True)
class Arguments:
    """Tell which tables are not of today's code."""

    runs: tuple[str, ...] = ()
    """folders of runs; by default all"""
    all: bool = False
    """list current and confirmed tables too"""
    check: bool = False
    """exit with 1 where a table is neither"""


def main() -> int:
    arguments = tyro.cli(Arguments, description=__doc__)
    found = list(findings(named(TABLES, arguments.runs)))
    stale = [one for one in found if one.state in ("stale", "unknown")]
    told = found if arguments.all else stale
    for one in told:
        print(line(one))
    if told:
        counts = Counter(one.state for one in found)
        print(", ".join(f"{counts[state]} {state}" for state in get_args(State)))
    return int(arguments.check and bool(stale))


def line(found: Finding) -> str:
    """What is to be said of a table."""
    table = found.table
    count = ", ".join(f"{n} {state}" for state, n in found.states.items())
    said = [f"{found.state:9} {table.title}: {count}"]
    if found.changed:
        said.append(f"changed since: {', '.join(found.changed)}")
    if found.states.get("unknown"):
        said.append(before(found))
    made = f"made by {', '.join(found.made)}" if found.made else ""
    return "; ".join(filter(None, [*said, made, f"here {table.code.digest}"]))


def before(found: Finding) -> str:
    """When git had the results first, and how often a file of their code changed since."""
    results = [str(path) for path in found.table.paths()]
    if not (stored := git("log", "-1", "--format=%h of %cs", "--", *results)):
        return ""
    files = [str(path) for path in found.table.code.files]
    changes = git("log", "--format=%h", f"{stored.split()[0]}..HEAD", "--", *files).splitlines()
    return f"stored by {stored}, {len(changes)} commits to its files since"


if __name__ == "__main__":
    sys.exit(main())
