"""Count the five trips through the house, and write them into docs/map.md.

    python docs/count_trips.py            # prints the tables
    python docs/count_trips.py --write    # puts them into the page

A trip is a list of stops, in the order in which a stranger opens them. A stop is a file, or a few
definitions of it; its lines are counted here, so that the page cannot claim another number.
"""

from __future__ import annotations

import ast
import sys
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "map.md"


@dataclass(frozen=True)
class Stop:
    """A file on the way, and what is found there."""

    path: str
    """from the root of the repository"""
    finds: str
    """what a reader looks for"""
    names: tuple[str, ...] = ()
    """the definitions to read; none: the whole file"""
    edit: bool = False
    """it is changed, too"""
    read: bool = True
    """it is read; a line in a list that is edited needs no reading"""

    @property
    def lines(self) -> int:
        """The lines to read."""
        text = (ROOT / self.path).read_text(encoding="utf-8")
        if not self.names:
            return len(text.splitlines())
        spans = definitions(text)
        return sum(spans[name] for name in self.names)


def definitions(text: str) -> dict[str, int]:
    """The lines of each class, function and method (`Class.method`), decorators included."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found[node.name] = _lines(node)
        if isinstance(node, ast.ClassDef):
            methods = [member for member in node.body if isinstance(member, ast.FunctionDef)]
            found |= {f"{node.name}.{method.name}": _lines(method) for method in methods}
    return found


def _lines(node: ast.ClassDef | ast.FunctionDef) -> int:
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    return (node.end_lineno or node.lineno) - first + 1


@dataclass(frozen=True)
class Trip:
    """A way that must be short, and how long it may be."""

    title: str
    stops: tuple[Stop, ...]
    files: int
    """that may be read at most"""
    edits: int | None = None
    """files that may be changed at most; none: nothing is changed"""
    lines: int | None = None
    """that may be read at most"""
    hops: tuple[str, ...] = ()
    """functions from the first line to the aim, each in another file than the one before"""
    most_hops: int | None = None

    @property
    def read(self) -> list[Stop]:
        """The stops that are read, a file counted once."""
        return [stop for stop in self.stops if stop.read]

    @property
    def total(self) -> int:
        """All lines to read."""
        return sum(stop.lines for stop in self.read)

    @property
    def files_read(self) -> int:
        return len({stop.path for stop in self.read})

    @property
    def files_edited(self) -> int:
        return len({stop.path for stop in self.stops if stop.edit})


TRIPS = (
    Trip(
        "Add a kernel",
        (
            Stop("mcpilco/kernels/base.py", "what a kernel inherits", ("Positive", "Kernel")),
            Stop("mcpilco/kernels/stationary.py", "an example; the new class", edit=True),
            Stop(
                "tests/mcpilco/kernels/test_kernels.py",
                "the laws of all kernels; a line in `KERNELS`",
                edit=True,
            ),
        ),
        files=3,
        edits=2,
    ),
    Trip(
        "Add an effect of a joint",
        (
            Stop("mcpilco/plant/effects/base.py", "what an effect says of itself"),
            Stop("mcpilco/plant/effects/joint.py", "the formulas; the new class", edit=True),
            Stop("mcpilco/plant/effects/__init__.py", "the catalogue; one line", edit=True),
            Stop(
                "tests/mcpilco/plant/effects/test_catalogue.py",
                "the laws of all effects; a row in `ROWS`",
                edit=True,
            ),
        ),
        files=4,
        edits=3,
    ),
    Trip(
        "Add an environment",
        (
            Stop("mcpilco/plant/plant.py", "what a plant is made of"),
            Stop("envs/plants.py", "the plants and `register`; the new plant", edit=True),
            Stop("envs/pendulum.py", "an example; a module like it is added", edit=True),
            Stop("envs/swing_up.py", "how plant and task fit"),
            Stop("envs/swing_up_env.py", "episodes"),
        ),
        files=5,
        edits=2,
    ),
    Trip(
        "Follow the policy search",
        (
            Stop("mcpilco/agent/trial_agent.py", "the loop over trials", ("TrialAgent.learn",)),
            Stop("mcpilco/agent/model_based.py", "a trial: fit, search, try"),
            Stop(
                "mcpilco/agent/agent.py",
                "the expected cost as a function of the policy",
                ("MCPILCO",),
            ),
            Stop(
                "mcpilco/search/search.py",
                "gradient steps, from several initial policies",
                ("Candidate", "SearchResult", "Starts", "Descent", "PolicySearch"),
            ),
            Stop("mcpilco/search/particles.py", "the rollout"),
            Stop("mcpilco/agent/model.py", "the model of a task: kernel, rows, fit", ("Model",)),
            Stop("mcpilco/dynamics/dynamics.py", "one step: increments, speed integration"),
            Stop("mcpilco/gp/gp.py", "posterior and fit", ("Posterior", "GP")),
            Stop("mcpilco/policies/policies.py", "the policy", ("SumOfGaussians",)),
        ),
        files=9,
        lines=1900,
        hops=(
            "TrialAgent.learn",
            "ModelBasedAgent._trial",
            "MCPILCO._search",
            "PolicySearch.step",
        ),
        most_hops=4,
    ),
    Trip(
        "See how `gap` decides",
        (
            Stop("mcpilco/gap/investigation.py", "the whole investigation"),
            Stop("mcpilco/gap/data.py", "windows of the recordings", ("Windows",)),
            Stop("mcpilco/gap/fit.py", "a fit, initial states eliminated", ("Fit", "fit_model")),
            Stop("mcpilco/gap/screen.py", "which effect would help most", ("screen",)),
            Stop(
                "mcpilco/gap/search.py",
                "models change by single effects, compared by BIC",
                ("SearchResult", "Tried", "search"),
            ),
            Stop(
                "mcpilco/gap/disturbance.py",
                "the random force in each joint, the evidence",
                ("Evidence", "Disturbance"),
            ),
            Stop(
                "mcpilco/gap/decide.py",
                "what is left over, which effects are named",
                (
                    "leaves_something",
                    "mispredicts",
                    "closes_most",
                    "Weighed",
                    "weighed",
                    "NamedEffect",
                    "named_effects",
                ),
            ),
            Stop("mcpilco/gap/thresholds.py", "every threshold, with unit and reason"),
        ),
        files=8,
        lines=1500,
    ),
)


def summary(trip: Trip) -> str:
    """A trip's numbers in a sentence."""
    parts = [f"{trip.files_read} files to read, {trip.total:,} lines"]
    if trip.edits is not None:
        parts.append(f"{trip.files_edited} to edit")
    if trip.most_hops is not None:
        parts.append(f"{len(trip.hops) - 1} hops from file to file")
    return "; ".join(parts)


def table(trip: Trip) -> str:
    """A trip as a section of the page."""
    rows = [f"### {trip.title}", "", f"{summary(trip)}.", ""]
    if trip.hops:
        rows += ["To the first gradient: " + " → ".join(f"`{hop}`" for hop in trip.hops) + ".", ""]
    rows += ["| | open | lines | to see |", "|---|---|---|---|"]
    for number, stop in enumerate(trip.stops, 1):
        do = "edit" if stop.edit else "read"
        where = f"`{stop.path}`" + (
            f": {', '.join(f'`{n}`' for n in stop.names)}" if stop.names else ""
        )
        rows.append(
            f"| {number} {do} | {where} | {stop.lines if stop.read else ''} | {stop.finds} |"
        )
    return "\n".join(rows)


START, END = "<!-- trips: written by docs/count_trips.py -->\n", "<!-- end of trips -->"


def written(page: str) -> str:
    """The page with the tables as they are now."""
    head, _, rest = page.partition(START)
    return (
        head + START + "\n" + "\n\n".join(map(table, TRIPS)) + "\n\n" + END + rest.partition(END)[2]
    )


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print("\n\n".join(map(table, TRIPS)))
