"""Laws of what results say of the code that made them."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import all_tables
import evidence
import provenance
import pytest
import stale
from all_tables import Table
from evidence import Stamp, findings, stamp, state_of
from harness import keep, kept, swept

import mcpilco.sweep
from mcpilco.config import Config
from mcpilco.sweep import Settings
from tests.mcpilco.test_sweep import HereEngine

pytestmark = pytest.mark.xdist_group("provenance")  # one process reads all code for all of them
SLIM = Table("limits", "results/slim/*.json", ("mcpilco.sweep:parse_seeds",), "0:3,7")
OTHER = Table("limits", "results/other/*.json", ("mcpilco.kernels:RBF",))


@pytest.fixture
def slim(monkeypatch):
    """Two tables of little code in place of all."""
    monkeypatch.setattr(all_tables, "TABLES", (SLIM, OTHER))
    stamp.cache_clear()
    yield
    stamp.cache_clear()


@pytest.mark.usefixtures("slim")
def test_a_result_that_is_kept_says_code_machine_and_role(tmp_path):
    keep(tmp_path / "results/slim/0001.json", {"found": 1}, "limits")
    (found,) = kept(tmp_path / "results/slim")
    assert found["found"] == 1
    assert found["machine"] == mcpilco.sweep.machine()
    assert found["made"]["digest"] == SLIM.code.digest
    assert found["made"]["parts"] == SLIM.code.parts
    assert found["made"]["role"] == "chosen on"
    assert state_of(found["made"], SLIM.code) == "current"


@pytest.mark.usefixtures("slim")
def test_a_result_of_a_run_without_such_a_table_is_refused(tmp_path):
    with pytest.raises(LookupError, match=r"runs/all_tables\.py"):
        keep(tmp_path / "results/fat/0001.json", {}, "limits")


@pytest.mark.usefixtures("slim")
@pytest.mark.parametrize("begun", [{}, {"made": {"digest": "another"}}])
def test_a_result_that_other_code_began_has_no_digest(tmp_path, begun):
    path = tmp_path / "results/slim/0001.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(begun))
    keep(path, {"found": 2}, "limits", continued=True)
    assert state_of(evidence.read_made(path), SLIM.code) == "unknown"
    keep(path, {"found": 3}, "limits")
    assert state_of(evidence.read_made(path), SLIM.code) == "current"
    keep(path, {"found": 4}, "limits", continued=True)
    assert state_of(evidence.read_made(path), SLIM.code) == "current"


def test_a_result_whose_code_was_edited_on_the_way_has_no_digest(monkeypatch, tmp_path):
    by = Stamp(SLIM)
    monkeypatch.setattr(evidence, "edited", lambda files: True)
    assert by.on({}, tmp_path / "0001.json")["made"]["digest"] is None


def test_a_stamp_can_be_sent_to_another_process():
    by = pickle.loads(pickle.dumps(Stamp(SLIM)))  # noqa: S301  ours
    assert by.on({}, Path("results/slim/0001.json"))["made"]["digest"] == SLIM.code.digest


@pytest.mark.usefixtures("slim")
def test_each_seed_of_a_sweep_says_its_code(tmp_path, monkeypatch):
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: HereEngine())
    path = tmp_path / "results/slim"
    table = Table("limits", "results/slim/seeds/*.json", SLIM.made_by, "0:1")
    monkeypatch.setattr(all_tables, "TABLES", (table,))

    def job(settings, seed):
        about = {"format": 1, "seed": seed, "trials": [], "machine": {}, "versions": {}}
        return lambda: about

    swept(Settings("none", config=Config(), trials=1), [0, 1], path, "limits", make_job=job)
    made = [evidence.read_made(path / f"seeds/000{seed}.json") for seed in (0, 1)]
    assert [one["role"] for one in made] == ["chosen on", "tested on"]
    assert {one["digest"] for one in made} == {table.code.digest}


# Stale --------------------------------------------------------------------------------------------


@pytest.fixture
def stored(tmp_path, monkeypatch):
    """Results of both tables, of today's code."""
    for module in (all_tables, evidence):
        monkeypatch.setattr(module, "RUNS", tmp_path)
    for table in (SLIM, OTHER):
        path = tmp_path / "limits" / table.results.replace("*", "0001")
        path.parent.mkdir(parents=True)
        path.write_text(json.dumps(Stamp(table).on({}, path)))
    yield tmp_path
    monkeypatch.undo()
    provenance.forget()


def fresh(*tables: Table) -> list[Table]:
    """The tables without what they have digested."""
    return [replace(table) for table in tables]


def change(monkeypatch, path: str, old: str, new: str) -> None:
    file = provenance.ROOT / path
    text = provenance.SOURCES[file].decode()
    assert old in text
    monkeypatch.setitem(provenance.SOURCES, file, text.replace(old, new).encode())
    provenance.forget()


def states(*tables: Table) -> dict[str, str]:
    return {found.table.results: found.state for found in findings(fresh(*tables))}


def test_a_changed_module_makes_exactly_its_tables_stale(stored, monkeypatch):
    current = {SLIM.results: "current", OTHER.results: "current"}
    assert states(SLIM, OTHER) == current
    change(monkeypatch, "mcpilco/show/film.py", "def ", "def other_")
    assert states(SLIM, OTHER) == current
    change(monkeypatch, "mcpilco/kernels/stationary.py", "self.spread(lengthscale", "self.spread(1")
    assert states(SLIM, OTHER) == {SLIM.results: "current", OTHER.results: "stale"}
    (stale,) = findings(fresh(OTHER))
    assert stale.changed == ("mcpilco.kernels",)


def test_what_is_unknown_is_told_before_what_is_stale(stored):
    path = stored / "limits/results/slim/0002.json"
    path.write_text(json.dumps({"made": {"digest": "0", "parts": {}, "commit": None}}))
    (found,) = findings(fresh(SLIM))
    assert (found.state, found.states) == ("stale", {"current": 1, "stale": 1})
    assert set(found.changed) == set(SLIM.code.parts)
    (stored / "limits/results/slim/0003.json").write_text("{}")
    (found,) = findings(fresh(SLIM))
    assert found.state == "unknown"


def test_a_table_of_csv_files_is_told_by_the_files_beside_them(stored):
    table = Table("limits", "results/csv/*.csv", SLIM.made_by)
    path = stored / "limits/results/csv/0001.csv"
    path.parent.mkdir()
    path.write_text("a\n1\n")
    assert states(table) == {table.results: "unknown"}
    path.with_suffix(".json").write_text(json.dumps(Stamp(table).on({}, path)))
    assert states(table) == {table.results: "current"}


def said(monkeypatch, capsys, *arguments: str) -> tuple[int, str]:
    monkeypatch.setattr("sys.argv", ["stale.py", *arguments])
    monkeypatch.setattr(stale, "TABLES", fresh(SLIM, OTHER))
    code = stale.main()
    return code, capsys.readouterr().out


def test_the_command_says_nothing_where_all_is_current(stored, monkeypatch, capsys):
    assert said(monkeypatch, capsys, "--check") == (0, "")
    code, text = said(monkeypatch, capsys, "--all")
    assert (code, text.splitlines()[-1]) == (0, "2 current, 0 confirmed, 0 stale, 0 unknown")


def test_the_command_names_what_is_stale_and_what_changed(stored, monkeypatch, capsys):
    change(monkeypatch, "mcpilco/kernels/stationary.py", "self.spread(lengthscale", "self.spread(1")
    code, text = said(monkeypatch, capsys)
    first, last = text.splitlines()
    assert code == 0
    assert first.startswith("stale     limits: results/other/*.json: 1 stale")
    assert "changed since: mcpilco.kernels" in first
    assert last == "1 current, 0 confirmed, 1 stale, 0 unknown"
    assert said(monkeypatch, capsys, "--check")[0] == 1
    with pytest.raises(SystemExit, match="folders of runs"):
        said(monkeypatch, capsys, "--runs", "nothing")
