"""Laws of damaged run folders: read as they were or refused with a sentence, never executed."""

from __future__ import annotations

import collections
import json
from pathlib import Path

import pytest

from tests.mcpilco import fuzz
from tests.mcpilco.survival import exit_code, process, train


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is whole."""
    path = tmp_path_factory.mktemp("fuzz") / "source"
    assert exit_code(train(path)) == 0
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("first", "cases"), [(0, 6), (1000, 1000)])
def test_a_damaged_run_is_read_or_refused(
    source: Path, tmp_path: Path, first: int, cases: int, record_property
) -> None:
    """In processes of fifty damaged folders each, with little memory and little time."""
    report, work = tmp_path / "report.jsonl", tmp_path / "work"
    work.mkdir()
    seeds = list(range(first, first + cases))
    for begin in range(0, cases, 50):
        part = seeds[begin : begin + 50]
        child = process(fuzz.try_all, str(source), str(work), part, str(report))
        child.join()
        assert child.exitcode == 0, f"broke down after {report.read_text().splitlines()[-1]}"
    lines = [json.loads(line) for line in report.read_text().splitlines()]
    assert [line["seed"] for line in lines] == seeds
    found = [(name, outcome) for line in lines for name, outcome in line["outcomes"].items()]
    bad = [line for line in lines if not set(line["outcomes"].values()) <= {"read", "refused"}]
    assert not bad, json.dumps(bad[:5], indent=1).replace("\\n", "\n")
    counts = collections.Counter(f"{name} {outcome}" for name, outcome in found)
    record_property("counts", dict(counts))
    record_property("most_memory_bytes", max(line["grown"] for line in lines))
    refused = [line for line in lines if "refused" in line["outcomes"].values()]
    assert len(refused) > 0.5 * cases  # the damage is real
