from __future__ import annotations

import dataclasses
import json
import math
import sys

import pytest
from harness import BEGIN, END

from mcpilco.sweep.folder import summarise


def make_trials(shares, cpu_s=10.0):
    """Trials of these shares of success."""
    return [
        {
            "trial": k,
            "experience_s": 3.0 * k,
            "success": p > 0.5,
            "p": p,
            "policy_steps": 500,
            "cpu_s": cpu_s,
            **dict.fromkeys(("return", "fresh_return", "time_up_s", "mean_abs_cart_m"), 1.0),
            **dict.fromkeys(("predicted_cost", "real_cost", "starts", "wall_s"), 1.0),
        }
        for k, p in enumerate(shares, start=1)
    ]


@pytest.fixture
def write(run, tmp_path):
    """Write README.md from the shares of success of seeds on a system, and return it."""

    def write(system="cartpole", failed=None, **settings):
        for name, by_seed in settings.items():
            folder = tmp_path / "results" / system / name
            (folder / "seeds").mkdir(parents=True)
            results = {
                seed: {
                    "seed": seed,
                    "trials": make_trials(shares),
                    "machine": {"cpu": "Zen", "cores": 2},
                    "versions": {"python": "3.11"},
                }
                for seed, shares in by_seed.items()
            }
            for seed, result in results.items():
                (folder / "seeds" / f"{seed:04d}.json").write_text(json.dumps(result))
            summary = summarise(results, failed or {})
            (folder / "summary.json").write_text(json.dumps(summary))
        run.write_readme(tmp_path)
        return (tmp_path / "README.md").read_text()

    return write


@pytest.mark.slow  # trains, if quickly
def test_quick_runs_a_seed_where_the_setting_is_compared_and_goes_on(
    run, tmp_path, monkeypatch, capsys
):
    arguments = ["run.py", "--quick", "--settings", "path", "--workers", "1"]
    monkeypatch.setattr(sys, "argv", [*arguments, "--out", str(tmp_path)])

    def quick():
        assert run.main() == 0
        return (tmp_path / "README.md").read_text()

    text = quick()
    assert "| `path` | 1 | 0.0 | 0 (seed 0) |" in text
    about = json.loads((tmp_path / "results" / "cartpole" / "path" / "sweep.json").read_text())
    assert about["config"]["model"]["sampling"] == "path"
    assert [path.name for path in (tmp_path / "results").iterdir()] == ["cartpole"]
    assert quick() == text
    assert "1 of 1 seeds are there already" in capsys.readouterr().out


def differing(there, here, prefix=""):
    """The names of the entries in which two configurations differ."""
    names = set()
    for key, value in there.items():
        if isinstance(value, dict):
            names |= differing(value, here[key], f"{prefix}{key}.")
        elif value != here[key]:
            names.add(prefix + key)
    return names


def test_each_setting_is_the_default_with_one_change(run):
    default, plain, path = (run.SETTINGS[name] for name in ("default", "step-eager", "path"))
    changed = {
        name: differing(dataclasses.asdict(default), dataclasses.asdict(config))
        for name, config in run.SETTINGS.items()
    }
    assert changed.pop("default") == set()
    assert changed.pop("path") == {"engine", "model.sampling"}
    assert changed.pop("screened") == {"search.restarts", "search.screening"}
    assert all(len(names) == 1 for names in changed.values())
    assert differing(dataclasses.asdict(plain), dataclasses.asdict(path)) == {"model.sampling"}
    rates = [phase.dropout for phase in run.SETTINGS["dropout"].search.phases]
    assert rates == [0.25, 0.125, 0.0]
    learning_rates = [phase.learning_rate for phase in run.SETTINGS["dropout"].search.phases]
    assert learning_rates == [phase.learning_rate for phase in default.search.phases]


@pytest.mark.parametrize(
    ("shares", "seconds"),
    [([0.9, 0.0], 10.0), ([0.89, 1.0, 1.0], 20.0), ([0.0, 0.89], math.inf)],
)
def test_solved_seconds_end_with_the_first_trial_that_solves_it(run, shares, seconds):
    assert run.solved_seconds(make_trials(shares)) == seconds


def test_a_row_holds_what_a_setting_gives_and_takes(write):
    text = write(default={0: [0.0, 1.0], 1: [1.0, 0.5], 2: [0.5, 0.75]})
    assert "### `mcpilco/CartPoleSwingUp-v0`" in text
    assert "### `mcpilco/Pendulum-v0`" not in text
    assert "| setting | seeds | p after 3 s [%] | p after 6 s [%] |" in text
    assert "| `default` | 3 | 50.0 (0–100) | 75.0 (50–100) | 50 (seed 1) | 20.0 (20.0–20.0)" in text
    assert "| 1000 (1000–1000) | 20.0 (2) |\n" in text
    assert "- `cartpole/default`: Zen, 2 cores; python 3.11" in text


def test_a_task_that_most_seeds_never_solve_takes_infinitely_long(write):
    assert "| inf (1) |" in write(default={0: [1.0], 1: [0.0], 2: [0.0]})


def test_differences_are_taken_seed_by_seed(write):
    text = write(
        default={0: [0.5, 0.5], 1: [0.25, 0.5], 5: [1.0, 1.0]},
        float32={0: [0.25, 0.5], 1: [0.0, 0.5], 2: [0.0, 0.0]},
        dropout={7: [0.0, 0.0]},
    )
    row = "| `float32` | 2 | -25.0 (-25 to -25) | 0.0 (0 to 0) | -12.5 (-12 to -12) |"
    assert row in text
    assert text.split(BEGIN)[1].count("| `dropout` |") == 1  # no seed in common: no difference


def test_without_the_default_there_is_no_difference(write):
    text = write("pendulum", path={0: [0.25]})
    assert "The differences of p need results of `default`." in text


def test_seeds_that_broke_off_are_listed(write):
    text = write(failed={7: "it was killed"}, default={0: [1.0]})
    assert "- `cartpole/default`, seed 7 broke off: it was killed\n" in text
    assert "broke off" in write("pendulum", failed={3: "no luck"}, default={})


def test_without_results_nothing_is_measured(write):
    assert f"{BEGIN}\n\nNot measured yet.\n\n{END}" in write()


def test_page_names_every_setting_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    about = text.split(BEGIN)[0]
    assert all(f"`{name}`" in about for name in run.SETTINGS)
