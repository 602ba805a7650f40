from __future__ import annotations

import json
import sys

import numpy as np
import pytest
from harness import BEGIN, END

import envs


def trial(success: bool, p: float, seconds: float) -> dict:
    return {"success": success, "p": p, "experience_s": seconds, "time_up_s": 1.1, "cpu_s": 2.0}


def result(seed: int, *trials: dict, over: bool = True) -> dict:
    about = {"cpu": "a processor", "cores": 2}
    return {"seed": seed, "over": over, "trials": list(trials), "machine": about}


def test_last_policy_is_learned_from_60_s(run):
    env = envs.PendubotEnv()
    assert run.TRIALS * 50 * env.task.dt == 60.0


def test_physics_know_masses_that_are_wrong_by_up_to_a_fifth(run):
    true = envs.PLANTS["mcpilco/Pendubot-v0"]().values
    errors = []
    for seed in range(30):
        told = run.config_of("physics+rbf", seed).model.plant["parameters"]
        errors.append([told[name] / true[name] - 1.0 for name in run.MASSES])
    assert np.abs(errors).max() <= run.WRONG
    assert np.abs(errors).max(0).min() > 0.8 * run.WRONG
    assert run.config_of("rbf+mpk", 3).model.plant is None


@pytest.mark.slow
def test_quick_learns_a_seed_of_each_model_and_goes_on(run, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["run.py", "--quick", "--out", str(tmp_path)])
    texts = []
    for _ in range(2):
        assert run.main() == 0
        texts.append((tmp_path / "README.md").read_text())
    assert texts[0] == texts[1]
    for name in run.MODELS:
        found = json.loads((tmp_path / "results" / name / "0000.json").read_text())
        assert found["over"]
        assert [row["experience_s"] for row in found["trials"]] == [2.5, 5.0]
        assert f"| `{name}` | 0 | 2 |" in texts[0]


def test_a_seed_that_is_not_over_is_trained_again(run, tmp_path, monkeypatch):
    path = tmp_path / "results" / "rbf+mpk" / "0000.json"
    path.parent.mkdir(parents=True)
    path.write_text(json.dumps(result(0, trial(False, 0.0, 2.5), over=False)))
    called = []
    ended = result(0, trial(True, 1.0, 2.5))
    monkeypatch.setattr(run, "learned", lambda *a: called.append(a) or iter([ended]))
    arguments = ["run.py", "--seeds", "0:1", "--models", "rbf+mpk", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    assert run.main() == run.main() == 0
    assert len(called) == 1


def test_table_counts_seeds_that_succeeded_and_those_that_were_solved(run):
    seeds = [
        result(0, trial(False, 0.2, 2.5), trial(True, 0.5, 5.0), trial(True, 0.9, 7.5)),
        result(1, trial(True, 0.4, 2.5), trial(False, 0.95, 5.0)),
        result(2, trial(False, 0.0, 2.5)),
        result(3, trial(True, 1.0, 2.5), over=False),
    ]
    (row,) = [line for line in run.table({"rbf+mpk": seeds}).split("\n") if "`rbf+mpk`" in line]
    name, count, succeeded, solved, seconds, *_ = [cell.strip() for cell in row.split("|")[1:]]
    assert (name, count) == ("`rbf+mpk`", "3")
    assert succeeded.startswith("66.7")
    assert solved.startswith("33.3")
    assert seconds == "7.5 (7.5–7.5)"


def test_page_names_every_model_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    assert all(f"`{name}`" in text.split(BEGIN)[0] for name in run.MODELS)
