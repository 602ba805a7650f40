from __future__ import annotations

import dataclasses
import json
import sys

import pytest
import torch
from harness import BEGIN, END

import mcpilco.sweep
from mcpilco.agent import load_task
from tests.mcpilco.test_sweep import HereEngine
from tests.runs.test_recipe import differing


def test_each_row_is_its_base_with_one_change(run):
    for base in run.BASES.values():
        for row in run.ROWS.values():
            names = differing(dataclasses.asdict(base), dataclasses.asdict(row.change(base)))
            assert len(names) + (row.task is not None) == (row is not run.ROWS["base"])


@pytest.mark.parametrize("name", ["tip_cost", "later_cost"])
def test_a_task_differs_from_the_envs_in_its_cost_only(name, home):
    import gymnasium

    import envs  # noqa: F401  registers the cart-pole

    shown = gymnasium.make("mcpilco/CartPoleSwingUp-v0").unwrapped.task
    task = load_task(home / f"{name}.py")
    assert dataclasses.replace(task, cost=shown.cost) == shown
    up, hanging, aside = torch.tensor([[0.0, 0, torch.pi, 0], [0, 0, 0, 0], [0.2, 0, torch.pi, 0]])
    costs = [float(task.cost(state.double())) for state in (up, aside, hanging)]
    assert costs == sorted(costs)
    assert costs[0] == pytest.approx(0.0, abs=1e-6)
    assert all(task.cost.widened(2.0)(s.double()) < task.cost(s.double()) for s in (aside, hanging))


@pytest.mark.slow
def test_quick_runs_a_seed_of_each_base_and_goes_on(run, tmp_path, monkeypatch, capsys):
    engine = HereEngine()
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: engine)
    arguments = ["run.py", "--quick", "--rows", "base", "tip-cost", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    texts = []
    for _ in range(2):
        assert run.main() == 0
        texts.append((tmp_path / "README.md").read_text())
    assert texts[0] == texts[1]
    assert capsys.readouterr().out.count("1 of 1 seeds are there already") == 4
    for base in run.BASES:
        about = json.loads((tmp_path / "results" / base / "tip-cost" / "sweep.json").read_text())
        assert about["task"].endswith("runs/ablations/tip_cost.py")
        assert f"### Changes of `{base}`" in texts[0]
    assert texts[0].count("| `tip-cost` | 1 | 0.0 |") == 4  # success, and its difference


def test_page_names_every_row_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    about = text.split(BEGIN)[0]
    assert all(f"`{name}`" in about for name in (*run.ROWS, *run.BASES))
