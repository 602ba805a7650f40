"""Each number of README is traced: to results that are stored, or to a fact that is no measurement.

Tables between marked lines are what their command writes from stored results. What is left of the
prose may hold the numbers of `FACTS` alone: no measured claim stands outside a table.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
sys.path.append(str(ROOT / "runs"))

import claims  # noqa: E402
import harness  # noqa: E402

from mcpilco.logbook import read_json  # noqa: E402
from mcpilco.sweep import read_run, summarise  # noqa: E402
from tests.runs.test_pages import RUNS, script  # noqa: E402

# --- tables ---------------------------------------------------------------------------------------


def crossing(run: ModuleType, home: Path) -> list[str]:
    return [run.pages.story([read_json(p) for p in sorted(home.glob("results/seeds/*.json"))])]


def comparison(run: ModuleType, home: Path) -> list[str]:
    results = home / "results" / "cartpole"
    summaries = run.read_summaries(results, run.ROWS)
    return run.tables.overview([read_run(results / name) for name in summaries])


def hidden(run: ModuleType, home: Path) -> list[str]:
    found = {
        tier: [read_json(path) for path in sorted((home / "results" / tier).glob("*.json"))]
        for tier in run.TIERS
    }
    found = {tier: cases for tier, cases in found.items() if cases}
    return [sys.modules["page"].by_tier(found), sys.modules["page"].in_short(found)]


BLOCKS: dict[str, tuple[str, Callable[[ModuleType, Path], list[str]]]] = {
    "results": ("cartpole_swingup", lambda run, home: run.overview(home / "results")),
    "crossing": ("crossing_the_gap", crossing),
    "comparison": ("cartpole_comparison", comparison),
    "hidden": ("hidden_effects", hidden),
}
"""marked part -> the run that writes it, and how"""
CLAIMED = {
    "claims": claims.parts,
    "shortfalls": lambda: [claims.table(claims.SHORTFALLS)],
}
"""those of runs/claims.py"""


def part(name: str) -> str:
    """What stands between the marked lines of a part."""
    begin, end = marked(name)
    text = README.read_text(encoding="utf-8")
    assert text.count(begin) == text.count(end) == 1
    return text.partition(begin)[2].partition(end)[0].strip()


def marked(name: str) -> tuple[str, str]:
    return harness.marks(name, claims.BY) if name in CLAIMED else harness.marks(name)


def joined(parts: list[str]) -> str:
    return "\n\n".join(part.strip() for part in parts if part)


@pytest.mark.parametrize("name", BLOCKS)
def test_a_table_of_a_run_is_what_its_results_say(name):
    run, write = BLOCKS[name]
    with script(run) as module:
        assert part(name) == joined(list(write(module, RUNS / run)))


@pytest.mark.parametrize("name", CLAIMED)
def test_a_table_of_claims_is_what_the_results_say(name):
    """Where it is not, `python runs/claims.py` writes it anew."""
    assert part(name) == joined(CLAIMED[name]())


def test_every_marked_part_is_compared():
    names = re.findall(r"<!-- (\w+): written by", README.read_text(encoding="utf-8"))
    assert sorted(names) == sorted({**BLOCKS, **CLAIMED})


@pytest.mark.parametrize("claim", claims.CLAIMS + claims.SHORTFALLS, ids=lambda claim: claim.says)
def test_a_claim_has_results(claim):
    assert claim.paths()
    assert not set(claim.paths()) - set(claim.table.paths())


SUMMED = sorted(
    path.parent
    for run in ("cartpole_swingup", "cartpole_comparison")
    for path in (RUNS / run / "results").rglob("summary.json")
)


@pytest.mark.parametrize("folder", SUMMED, ids=lambda folder: "/".join(folder.parts[-2:]))
def test_a_summary_is_that_of_its_seeds(folder):
    results = [read_json(path) for path in sorted((folder / "seeds").glob("*.json"))]
    summary = read_json(folder / "summary.json")
    again = summarise({result["seed"]: result for result in results}, {})
    assert {key: again[key] for key in ("seeds", "trials", "run")} == {
        key: summary[key] for key in ("seeds", "trials", "run")
    }


# --- prose ----------------------------------------------------------------------------------------

FACTS = {
    r"stable-baselines3": "a name",
    r"Python 3\.11 or newer": "pyproject.toml",
    r"\b3 s of inputs|for 3 s\b": "an episode of the env is 30 steps of 0.1 s",
    r"After 12 s of experience|after 12 s of experience|the cart-pole at 1 s": "of the picture",
    r"256 colours": "of the picture",
    r"share of 100 fresh episodes|solved is at least 90 %": "a rule of runs/crossing_the_gap",
    r"within 10 degrees of upright": "the rule of success, envs/judge.py",
    r"95 % intervals": "a level",
    r"exit code 2|C99": "of the command line",
    r"chapter \d( \(MC-PILCO\))?": "of the thesis",
    r"Transactions on Robotics 38 \(6\), 2022": "a citation",
    r"\b10\.1109/TRO\.2022\.3184837": "a citation",
}
"""numbers in the prose that no experiment gave, as patterns, and where they are from"""


def prose(text: str) -> str:
    """A page without its tables that are written, code, links' targets and comments."""
    for name in {**BLOCKS, **CLAIMED}:
        begin, end = marked(name)
        if begin in text:
            text = text.partition(begin)[0] + text.partition(end)[2]
    text = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"^    .*$", "", text, flags=re.MULTILINE)
    text = re.sub(r"`[^`]*`|\]\([^)]*\)|<!--.*?-->", "", text)
    return " ".join(text.split())


def untraced(text: str) -> list[str]:
    """The words with a number that is in none of `FACTS`, each with what stands around it."""
    told = re.sub("|".join(FACTS), lambda found: "_" * len(found[0]), prose(text))
    return [told[max(0, m.start() - 40) : m.end() + 40] for m in re.finditer(r"\d[\d.,]*", told)]


def test_no_number_of_the_prose_is_without_a_trace():
    assert untraced(README.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("sentence", ["It succeeds in 97 % of all.", "It takes 19 s, after 3 s."])
def test_a_number_without_a_trace_would_be_found(sentence):
    assert len(untraced(sentence)) == len(re.findall(r"\d+", sentence))


@pytest.mark.parametrize("fact", FACTS)
def test_every_fact_is_told(fact):
    assert re.search(fact, prose(README.read_text(encoding="utf-8")))


# --- docs -----------------------------------------------------------------------------------------

QUOTES = (
    (
        "limits.md",
        "none of 260 rollouts crossed with limits and 31 of 50 without",
        "limits",
        ("| within the limits | 50 | 260 | 0 (", "| without limits | 10 | 50 | 31 ("),
    ),
    (
        "model.md",
        "93 % of the swing-ups succeed after 3 s and all after 6 s; with `default`, in half the "
        "time, 72 and 96 %",
        "model_components",
        (
            "| `physics+rbf-thorough` | 10 | 93.0 (79–100) | 100.0 (100–100) |",
            "| `physics+rbf` | 10 | 72.4 (45–95) | 96.2 (89–100) |",
        ),
    ),
    (
        "model.md",
        "98, 100 and 99 % of the swing-ups succeed after 12, 15 and 15 s",
        "model_components",
        ("| 84.0 (62–99) | 97.6 (94–100) |", "| 100.0 (100–100) | 31", "| 99.0 (98–100) | 32"),
    ),
    (
        "identification.md",
        "with 0.39 to 0.67 of the error of the best other method",
        "ting_synthetic",
        ("| 0.39 |", "| OLS | 0.67 |"),
    ),
    (
        "sb3.md",
        "from nothing after 3600 to 9000",
        "warm_start",
        ("| `scratch` | 3600, 9000, 3600 | 0 |", "| `warm` | 0, 0, 0 | 150 |"),
    ),
)
"""measured numbers in docs: page, words, run, and parts of its tables from which they are taken"""


@pytest.mark.parametrize(("page", "words", "run", "parts"), QUOTES)
def test_what_docs_quote_stands_in_the_tables_of_a_run(page, words, run, parts):
    assert words in " ".join((ROOT / "docs" / page).read_text(encoding="utf-8").split())
    tables = (RUNS / run / "README.md").read_text(encoding="utf-8")
    assert all(part in tables.partition(harness.BEGIN)[2] for part in parts)
