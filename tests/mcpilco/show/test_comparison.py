"""What `write_comparison` writes, and what the command says."""

from __future__ import annotations

import csv

import pytest

from mcpilco.cli import main
from mcpilco.show.comparison import write_comparison
from mcpilco.sweep import line_up
from tests.mcpilco.sweep.folders import trials_of, write_sweep

PNG = b"\x89PNG"


@pytest.fixture
def two(tmp_path):
    """Two sweeps, the second one better and with a seed more."""
    one = {seed: trials_of([0.25, 0.5]) for seed in range(3)}
    other = {seed: trials_of([0.75, 1.0], cpu_s=20.0) for seed in range(4)}
    return [write_sweep(tmp_path / "one", one), write_sweep(tmp_path / "two", other, preset="tip")]


def read(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_tables_hold_what_the_seeds_reached(two, tmp_path):
    out = tmp_path / "out"
    written = write_comparison(line_up(two), out)
    assert [path.read_bytes()[:4] == PNG for path in written] == [False] * 4 + [True] * 2

    seeds = read(out / "seeds.csv")
    assert len(seeds) == 2 * 3 + 2 * 4
    last = seeds[-1]
    assert (last["run"], last["seed"], last["trial"], last["p"]) == ("two", "3", "2", "1.0")
    assert (last["cpu_s"], last["fresh_return"]) == ("40.0", "")

    key = ("run", "measure", "statistic", "experience_s")
    rows = {tuple(row[k] for k in key): row for row in read(out / "comparison.csv")}
    assert rows["one", "p", "median", "6.0"]["value"] == "50.0"
    assert rows["two", "success", "mean", "3.0"]["seeds"] == "4"

    gains = {(r["measure"], r["experience_s"]): r for r in read(out / "differences.csv")}
    found = gains["p", "3.0"]
    assert (found["run"], found["other"], found["seeds"]) == ("two", "one", "3")
    assert (found["low"], found["value"], found["high"]) == ("50.0", "50.0", "50.0")

    page = (out / "comparison.md").read_text()
    assert "| two | mcpilco | tip | 4 | 100 |" in page
    assert "| one | inf | 0 of 3 | inf | 0 of 3 |\n| two | 3 | 4 of 4 | 6 | 4 of 4 |" in page
    assert "| two minus one | 3 | 50.0 (50.0 to 50.0) | 50.0 (50.0 to 50.0) |" in page


@pytest.mark.slow
def test_equal_runs_give_equal_files(two, tmp_path):
    for name in ("a", "b"):
        write_comparison(line_up(two), tmp_path / name)
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


def test_one_seed_of_one_run_that_tells_no_success_has_a_page(tmp_path):
    rows = trials_of([None, None], mean_abs_cart_m=None)
    write_comparison(line_up([write_sweep(tmp_path / "a", {0: rows})]), tmp_path / "out")
    page = (tmp_path / "out" / "comparison.md").read_text()
    assert "### Return of the test rollout [-]" in page
    assert "Success" not in page
    assert "Differences" not in page


def test_command_prints_how_each_run_ends(two, tmp_path, capsys):
    assert main(["compare", *map(str, two), "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "…" not in printed
    assert printed.splitlines()[-1] == f"Tables: {tmp_path / 'out' / 'comparison.md'}"


@pytest.mark.slow
def test_command_leaves_out_what_it_cannot_compare_and_says_so(two, tmp_path, capsys):
    paths = [str(tmp_path / "absent"), *map(str, two)]
    assert main(["compare", *paths, "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 1
    assert told[0].startswith(f"mcpilco: left out: {tmp_path / 'absent'} holds neither a sweep")
    assert (tmp_path / "out" / "comparison.md").exists()


def test_command_without_a_run_is_refused(tmp_path, capsys):
    assert main(["compare", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    assert "holds neither a sweep" in capsys.readouterr().err
    assert main(["compare"]) == 2


def test_command_refuses_a_folder_that_cannot_be_written(two, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert main(["compare", str(two[0]), "--out", str(tmp_path / "file" / "out")]) == 2
    assert "cannot be written" in capsys.readouterr().err
