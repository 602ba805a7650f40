"""Laws of the tables: each result is of one, and each knows its code and its seeds."""

from __future__ import annotations

from pathlib import Path

import provenance
import pytest
from all_tables import TABLES, Table, table_of
from evidence import SAMPLES

pytestmark = pytest.mark.xdist_group("provenance")  # one process reads all code for all of them
RUNS = provenance.RUNS
SLIM = Table("limits", "results/slim/*.json", (), "0:3,7")


def tracked() -> list[Path]:
    """The files of runs/ that git knows; all, where there is no git."""
    listed = provenance.git("ls-files", "runs").splitlines()
    return [provenance.ROOT / line for line in listed] or sorted(RUNS.rglob("*"))


def test_every_result_is_of_one_table():
    data = [path for path in tracked() if path.suffix in (".json", ".csv")]
    data = [path for path in data if path.name not in ("sweep.json", "summary.json", SAMPLES)]
    beside = {path.with_suffix(".json") for path in data if path.suffix == ".csv"}
    assert data
    for path in set(data) - beside:
        run = path.relative_to(RUNS).parts[0]
        holding = [table.title for table in TABLES if table.run == run and table.holds(path)]
        assert len(holding) == 1, (path, holding)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(
    "table",
    {(table.run, table.made_by): table for table in TABLES}.values(),
    ids=lambda table: table.title,
)
def test_the_code_of_every_table_is_found(table):
    assert len(table.code.parts) > 1


def test_every_run_that_keeps_results_has_a_table():
    runs = {path.parent.name for path in RUNS.glob("*/README.md")}
    assert {table.run for table in TABLES} <= runs
    without = runs - {table.run for table in TABLES}
    assert without == {"identified_double_pendulum"}, "what a page shows is to be kept"


@pytest.mark.parametrize(
    ("name", "role"), [("0002", "chosen on"), ("0003", "tested on"), ("pd-7", "chosen on")]
)
def test_a_seed_was_chosen_on_or_is_tested_on(name, role):
    assert SLIM.role(Path(f"results/slim/{name}.json")) == role


def test_what_has_no_seed_has_no_role():
    assert SLIM.role(Path("results/slim/faults.json")) == "none"
    timed = Table("limits", "results/*.json", (), seeded=False)
    assert timed.role(Path("results/timing-100.json")) == "none"
    assert Table("limits", "results/*.json", (), ":").role(Path("results/8.json")) == "chosen on"


def test_what_stands_beside_a_csv_file_is_of_its_table(tmp_path):
    assert table_of("model_learning", tmp_path / "results/cartpole/0001.json").seeded
