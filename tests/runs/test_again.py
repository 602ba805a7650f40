"""Laws of results that today's code has made again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import again
import all_tables
import evidence
import pytest
from again import first_difference, samples_of
from all_tables import TABLES, Table
from evidence import findings

pytestmark = pytest.mark.xdist_group("provenance")  # one process reads all code for all of them
TABLE = Table(
    "tried", "results/*/*.json", ("mcpilco.sweep:parse_seeds",), again="--row {0} --seeds {seed}"
)
MADE = {"digest": "old", "parts": {}, "commit": None}
RUN = """
import json, sys
from pathlib import Path

row, seed, out = (sys.argv[sys.argv.index(name) + 1] for name in ("--row", "--seeds", "--out"))
path = Path(out) / "results" / row / f"{int(seed):04d}.json"
path.parent.mkdir(parents=True)
path.write_text(json.dumps({"found": int(seed) * FACTOR, "cpu_s": 0.5}))
"""


@pytest.mark.parametrize("table", [table for table in TABLES if table.again], ids=lambda t: t.title)
def test_each_stored_result_has_its_command(table):
    for path in table.paths():
        assert "{" not in " ".join(table.command(path))


def test_a_command_names_what_the_stars_stand_for():
    path = Path("runs/tried/results/no-drag/0030.json")
    assert TABLE.command(path) == ["--row", "no-drag", "--seeds", "30"]
    assert replace(TABLE, again="").command(path) == []


@pytest.mark.parametrize(
    ("stored", "found", "difference"),
    [
        ({"p": [1.0, 0.5]}, {"p": [1.0, 0.5]}, ""),
        ({"p": [1.0, 0.5]}, {"p": [1.0, 0.25]}, "p.1 was 0.5, is 0.25"),
        ({"p": 1.0}, {"p": 1.0 + 1e-9}, ""),
        ({"p": 1.0}, {"p": 1.00001}, "p was 1.0, is 1.00001"),
        ({"p": [1.0]}, {"p": [1.0, 0.5]}, "p was [1.0], is [1.0, 0.5]"),
        ({"cpu_s": 1.0, "made": {"digest": "a"}}, {"cpu_s": 2.0, "made": {"digest": "b"}}, ""),
        ({"p": 1, "peers": {"a": 1}}, {"p": 1}, ""),
        ({"p": float("nan")}, {"p": float("nan")}, ""),
        (["a,1", "b,2"], ["a,1", "b,3"], '1 was "b,2", is "b,3"'),
        (1, {}, "all was 1, is {}"),
    ],
)
def test_results_are_equal_but_for_times(stored, found, difference):
    assert first_difference(stored, found) == difference


@pytest.fixture
def tried(tmp_path, monkeypatch):
    """A run whose code makes the seed times a factor, with six results of two older codes."""
    folder = tmp_path / "runs/tried"
    (folder / "results/row").mkdir(parents=True)
    for module in (again, all_tables, evidence):
        monkeypatch.setattr(module, "RUNS", tmp_path / "runs")
        monkeypatch.setattr(module, "TABLES", (TABLE,))
    monkeypatch.setattr(again, "ROOT", tmp_path)
    (folder / "run.py").write_text(RUN.replace("FACTOR", "10"))
    for seed in range(6):
        made = MADE if seed < 4 else {**MADE, "digest": None}
        stored = {"found": seed * 10, "cpu_s": 9.0, "made": made}
        (folder / f"results/row/{seed:04d}.json").write_text(json.dumps(stored))
    return folder


def made_again(monkeypatch, *arguments: str) -> int:
    monkeypatch.setattr("sys.argv", ["again.py", *arguments])
    return again.main()


def states() -> dict[str, int]:
    (found,) = findings([replace(TABLE)])
    return dict(found.states)


def test_a_sample_is_of_each_code(tried):
    assert [
        (sample.of, [path.stem for path in sample.paths]) for sample in samples_of(TABLE, 2)
    ] == [
        ("old", ["0000", "0002"]),
        (None, ["0004", "0005"]),
    ]
    assert list(samples_of(replace(TABLE, again=""), 2)) == []


def test_what_is_made_again_is_confirmed_until_the_code_changes(tried, monkeypatch, capsys):
    assert states() == {"stale": 4, "unknown": 2}
    assert made_again(monkeypatch) == 0
    assert capsys.readouterr().out.startswith("confirmed tried: results/*/*.json: 2 of old")
    assert states() == {"confirmed": 6}
    (found,) = findings([replace(TABLE)])
    assert found.state == "confirmed"
    assert list(samples_of(TABLE, 2)) == []
    monkeypatch.setattr(all_tables.Code, "digest", "another")
    assert states() == {"stale": 4, "unknown": 2}


def test_what_differs_is_told_and_stays_stale(tried, monkeypatch, capsys):
    (tried / "results/row/0002.json").write_text(json.dumps({"found": 7, "made": MADE}))
    assert made_again(monkeypatch) == 1
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("differs ")
    assert first.endswith("results/row/0002.json: found was 7, is 20")
    assert second.startswith("confirmed")
    assert states() == {"stale": 4, "confirmed": 2}


def test_tables_are_named_by_their_results_too(tried, monkeypatch, capsys):
    assert made_again(monkeypatch, "--having", "other") == 0
    assert capsys.readouterr().out == ""
    assert made_again(monkeypatch, "--having", "*") == 0
    assert states() == {"confirmed": 6}


def test_results_of_named_code_alone_are_made_again(tried, monkeypatch):
    assert made_again(monkeypatch, "--of", "old", "--sample", "1") == 0
    assert states() == {"confirmed": 4, "unknown": 2}
    with pytest.raises(SystemExit, match="--of must name code .*, got .'other'."):
        made_again(monkeypatch, "--of", "other")


def test_a_command_that_fails_is_told_with_its_last_words(tried, monkeypatch, capsys):
    (tried / "run.py").write_text("raise SystemExit('no such seed')")
    assert made_again(monkeypatch, "--sample", "1") == 1
    assert "not made by --row row --seeds 0; no such seed" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("factor", "digest", "told", "code"),
    [
        (10, "old", "2 of old, beside abc123", 0),
        (11, "old", "found was 22, is 20", 1),
        (10, "new", "no commit that is named has the code of old", 1),
    ],
)
def test_beside_the_code_before_the_machine_does_not_count(
    tried, monkeypatch, capsys, factor, digest, told, code
):
    for path in (tried / "results/row").iterdir():  # as another machine rounds
        stored = json.loads(path.read_text())
        path.write_text(json.dumps({**stored, "found": stored["found"] + 1e-3}))
    assert made_again(monkeypatch) == 1

    def git(*arguments: str) -> str:
        if arguments[:2] == ("worktree", "add"):
            before = Path(arguments[3]) / "runs/tried"
            before.mkdir(parents=True)
            (before / "run.py").write_text(RUN.replace("FACTOR", str(factor)))
        return "abc123"

    monkeypatch.setattr(again, "git", git)
    monkeypatch.setattr(again, "digests", lambda root, run: [digest])
    capsys.readouterr()
    assert made_again(monkeypatch, "--beside") == code
    assert told in capsys.readouterr().out
    assert ("stale" not in states()) == (code == 0)


@pytest.mark.slow
def test_the_digest_of_a_checkout_is_that_of_its_tables():
    table = next(table for table in TABLES if table.run == "volterra")
    assert again.digests(again.ROOT, "volterra") == [table.code.digest]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("--runs", "nothing"), "folders of runs"), (("--sample", "0"), "1 or more")],
)
def test_wrong_arguments_are_refused(tried, monkeypatch, arguments, message):
    with pytest.raises(SystemExit, match=message):
        made_again(monkeypatch, *arguments)
