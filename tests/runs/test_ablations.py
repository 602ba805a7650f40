from __future__ import annotations

import dataclasses
import json
import math

import pytest
import torch
from harness import BEGIN, END

import mcpilco.sweep
from mcpilco.agent import load_task
from mcpilco.config import PRESETS
from mcpilco.sweep.folder import summarise
from tests.mcpilco.test_sweep import HereEngine


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
    """Write README.md from the shares of success of seeds from a base, and return it."""

    def write(preset="default", failed=None, **settings):
        for name, by_seed in settings.items():
            folder = tmp_path / "results" / preset / name
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


def differing(there, here, prefix=""):
    """The names of the entries in which two configurations differ."""
    names = set()
    for key, value in there.items():
        if isinstance(value, dict):
            names |= differing(value, here[key], f"{prefix}{key}.")
        elif value != here[key]:
            names.add(prefix + key)
    return names


def test_each_row_is_a_preset_with_one_change(run):
    for name, row in run.ROWS.items():
        for base in row.of:
            settings = run.settings_of(base, name)
            numbers = dataclasses.asdict(PRESETS[base].config)
            names = differing(numbers, dataclasses.asdict(settings.config))
            assert names - {"engine"} or name in ("base", "tip-cost", "later-cost")
            assert len(names - {"engine"}) + (settings.task is not None) == (name != "base")
            assert settings.env_kwargs == PRESETS[base].env_kwargs


def test_a_row_of_another_cost_names_its_file(run):
    assert run.settings_of("default", "tip-cost").task.endswith("runs/ablations/tip_cost.py")


def test_dropout_falls_over_three_phases_of_the_same_rates(run):
    for base in run.BASES:
        before, after = (run.settings_of(base, name).config.search for name in ("base", "dropout"))
        assert [phase.dropout for phase in after.phases] == [0.25, 0.125, 0.0]
        rates = {phase.learning_rate for phase in before.phases}
        assert {phase.learning_rate for phase in after.phases} == rates


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
def test_quick_runs_a_seed_of_each_base_and_goes_on(
    run, page_of_two, tmp_path, monkeypatch, capsys
):
    engine = HereEngine()
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: engine)
    page = page_of_two("--rows", "base", "dropout")
    assert capsys.readouterr().out.count("1 of 1 seeds are there already") == 4
    for base in run.BASES:
        about = json.loads((tmp_path / "results" / base / "dropout" / "sweep.json").read_text())
        assert about["preset"] == f"{base}-dropout"
        assert f"### Changes of `{base}`" in page
    assert page.count("| `dropout` | 1 | 0.0 |") == 4  # success, and its difference


def test_page_names_every_row_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    about = text.split(BEGIN)[0]
    assert all(f"`{name}`" in about for name in (*run.ROWS, *run.BASES))


@pytest.mark.parametrize(
    ("shares", "seconds"),
    [([0.9, 0.0], 10.0), ([0.89, 1.0, 1.0], 20.0), ([0.0, 0.89], math.inf)],
)
def test_solved_seconds_end_with_the_first_trial_that_solves_it(run, shares, seconds):
    assert run.solved_seconds(make_trials(shares)) == seconds


def test_a_row_holds_what_a_setting_gives_and_takes(write):
    text = write(base={0: [0.0, 1.0], 1: [1.0, 0.5], 2: [0.5, 0.75]})
    assert "### Changes of `default`" in text
    assert "### Changes of `thesis`" not in text
    assert "| setting | seeds | p after 3 s [%] | p after 6 s [%] |" in text
    assert "| `base` | 3 | 50.0 (0–100) | 75.0 (50–100) | 50 (seed 1) | 20.0 (20.0–20.0)" in text
    assert "| 1000 (1000–1000) | 20.0 (2) |\n" in text
    assert "- `default/base`: Zen, 2 cores; python 3.11" in text


def test_a_task_that_most_seeds_never_solve_takes_infinitely_long(write):
    assert "| inf (1) |" in write(base={0: [1.0], 1: [0.0], 2: [0.0]})


def test_differences_are_taken_seed_by_seed(write):
    text = write(
        base={0: [0.5, 0.5], 1: [0.25, 0.5], 5: [1.0, 1.0]},
        rbf={0: [0.25, 0.5], 1: [0.0, 0.5], 2: [0.0, 0.0]},
        dropout={7: [0.0, 0.0]},
    )
    row = "| `rbf` | 2 | -25.0 (-25 to -25) | 0.0 (0 to 0) | -12.5 (-12 to -12) |"
    assert row in text
    assert text.split(BEGIN)[1].count("| `dropout` |") == 1  # no seed in common: no difference


def test_without_the_default_there_is_no_difference(write):
    text = write("thesis", prior={0: [0.25]})
    assert "The differences of p need results of `base`." in text


def test_seeds_that_broke_off_are_listed(write):
    text = write(failed={7: "it was killed"}, base={0: [1.0]})
    assert "- `default/base`, seed 7 broke off: it was killed\n" in text
    assert "broke off" in write("thesis", failed={3: "no luck"}, base={})


def test_without_results_nothing_is_measured(write):
    assert f"{BEGIN}\n\nNot measured yet.\n\n{END}" in write()
