from __future__ import annotations

import json
from pathlib import Path

import pytest

from mcpilco.cli.options import column_maps, keywords, named_numbers
from mcpilco.typing import InputError


def test_keywords_are_numbers_truths_words_or_what_a_file_holds(tmp_path: Path) -> None:
    path = tmp_path / "corrected.json"
    path.write_text(json.dumps({"format": 1}))
    entries = ("mass=0.5", "steps=3", "noisy=false", "measured=positions", f"effects={path}")
    assert keywords("--env-kwargs", entries) == {
        "mass": 0.5,
        "steps": 3,
        "noisy": False,
        "measured": "positions",
        "effects": {"format": 1},
    }


def test_a_value_may_hold_an_equals_sign() -> None:
    assert keywords("--env-kwargs", ["name=a=b"]) == {"name": "a=b"}


def test_numbers_may_be_separated_by_commas() -> None:
    assert named_numbers("--set", ["a=1,b=2e-3", "c=inf"]) == {
        "a": 1.0,
        "b": 2e-3,
        "c": float("inf"),
    }


@pytest.mark.parametrize("entry", ["mass", "=3", ""])
def test_what_is_no_pair_is_refused(entry: str) -> None:
    with pytest.raises(InputError, match="--env-kwargs must be NAME=VALUE"):
        keywords("--env-kwargs", [entry])


def test_a_value_that_is_no_number_is_refused() -> None:
    with pytest.raises(InputError, match="--set a must be a number, got 'b'"):
        named_numbers("--set", ["a=b"])


def test_a_damaged_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "broken.json"
    path.write_text("{")
    with pytest.raises(InputError, match="broken.json is no JSON file"):
        keywords("--env-kwargs", [f"effects={path}"])


def test_columns_are_named_for_all_files_or_for_one_and_none_is_ignored() -> None:
    entries = ("time=t,angle=a:b", "old.csv:time=s,velocity=", "velocity=none")
    assert column_maps(entries) == {
        "*": {"time": "t", "angle": "a:b", "velocity": ""},
        "old.csv": {"time": "s", "velocity": ""},
    }
    with pytest.raises(InputError, match="--columns must be NAME=VALUE, got 'time'"):
        column_maps(("time",))
