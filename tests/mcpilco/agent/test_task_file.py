"""Laws of task files: what is written is what is read, and what is wrong gets a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from mcpilco.agent.task_file import load_task
from mcpilco.typing import InputError
from tests.mcpilco.swinging import CIRCLE, TASK

CIRCULAR = replace(TASK, **CIRCLE)

TOML = """
state_names = ["angle", "velocity"]
state_units = ["rad", "rad/s"]
input_names = ["torque"]
input_units = ["N m"]
dt = 0.1
angles = [0]
velocities = [[0, 1]]
start_mean = [0.5, 0.0]
start_std = [0.1, 0.1]
observed = [[0, 1], 2]
"""
COST = "def cost(states, inputs):\n    return states[..., 0] ** 2 + inputs[..., 0]\n"
PYTHON = "from tests.mcpilco.swinging import TASK\n"


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_toml_json_and_python_say_the_same(tmp_path: Path) -> None:
    assert load_task(written(tmp_path, "a.toml", TOML)) == CIRCULAR
    assert load_task(written(tmp_path, "a.json", json.dumps(CIRCULAR.to_json()))) == CIRCULAR
    assert load_task(written(tmp_path, "a.py", PYTHON)) is TASK


@pytest.mark.parametrize("named", ["my_cost.py:cost", "my_cost_module:cost"])
def test_a_cost_is_named_by_file_or_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, named: str
) -> None:
    (tmp_path / "my_cost.py").write_text(COST)
    (tmp_path / "my_cost_module.py").write_text(COST)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    task = load_task(written(tmp_path, "a.toml", TOML + f'cost = "{named}"\n'))
    assert task.cost(torch.tensor([3.0, 0.0]), torch.tensor([0.5])) == 9.5


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.yaml", "", "must end in .py, .toml or .json"),
        ("a.toml", "dt = ", "cannot be read"),
        ("a.json", "[1]", "must hold entries by name"),
        ("a.toml", "dt = 0.1", "holds no task: .*missing"),
        ("a.toml", TOML + "gravity = 1.0", "holds no task: .*gravity"),
        ("a.toml", TOML.replace("dt = 0.1", "dt = -1"), "dt must be positive"),
        ("a.toml", TOML + 'cost = "cost"', 'must be like "module:function"'),
        ("a.toml", TOML + "cost = 3", 'must be like "module:function"'),
        ("a.toml", TOML + 'cost = "nowhere.py:cost"', "nowhere.py"),
        ("a.toml", TOML + 'cost = "no_such_module:cost"', "Cannot import no_such_module"),
        ("a.toml", TOML + 'cost = "math:cost"', "math has no function 'cost'"),
        ("a.py", "x = 1", "must define TASK, .*got none"),
        ("a.py", "TASK = 1", "got TASK of type int"),
        ("a.py", "1 / 0", "cannot be executed .ZeroDivisionError"),
    ],
)
def test_what_is_no_task_is_answered_with_a_sentence(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        load_task(written(tmp_path, name, text))


def test_a_file_that_is_not_there_is_answered_with_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="There is no task file .*nothing.py"):
        load_task(tmp_path / "nothing.py")
