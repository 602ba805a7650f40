from __future__ import annotations

import json

import numpy as np
import pytest

from mcpilco.sweep import summary
from mcpilco.sweep.summary import mean, rate, spread, summarise, summary_table


def make_result(seed, successes, cpu_s=10.0):
    trials = [
        {
            "trial": trial,
            "experience_s": 3.0 * trial,
            "success": success,
            "p": None if success is None else 0.9 * success,
            "return": float(seed),
            "fresh_return": 1.0,
            "time_up_s": None if success is None else 1.5,
            "mean_abs_cart_m": None if success is None else 0.2,
            "predicted_cost": 10.0,
            "real_cost": 11.0,
            "starts": 1,
            "policy_steps": 500,
            "cpu_s": cpu_s,
            "wall_s": 12.0,
        }
        for trial, success in enumerate(successes, start=1)
    ]
    machine = {"cpu": "Zen", "cores": 2}
    return {"seed": seed, "trials": trials, "machine": machine, "versions": {"python": "3.11"}}


def test_rate_has_wilsons_interval():
    """Closed form: (s + z^2 / 2 +- z sqrt(s (n - s) / n + z^2 / 4)) / (n + z^2)."""
    found = rate([True] * 27 + [False] * 3 + [None])
    z, n, s = 1.959963984540054, 30, 27
    middle, half = s + z**2 / 2, z * np.sqrt(s * (n - s) / n + z**2 / 4)
    assert found["n"] == 30
    assert found["rate"] == pytest.approx(0.9)
    assert found["low"] == pytest.approx((middle - half) / (n + z**2))
    assert found["high"] == pytest.approx((middle + half) / (n + z**2))
    assert rate([None]) is None


def test_bootstrap_interval_has_the_width_of_the_normal_one():
    values = np.random.default_rng(0).normal(0.5, 0.1, 100)
    found = mean(values)
    half = 1.96 * values.std() / 10
    assert found["mean"] == pytest.approx(values.mean())
    assert found["low"] == pytest.approx(values.mean() - half, abs=0.1 * half)
    assert found["high"] == pytest.approx(values.mean() + half, abs=0.1 * half)
    assert found == mean(values)


@pytest.mark.filterwarnings("error")
def test_intervals_exist_where_all_seeds_agree_and_not_from_one_seed():
    assert mean([1.0, 1.0]) == {"n": 2, "mean": 1.0, "low": 1.0, "high": 1.0}
    assert mean([1.0]) == {"n": 1, "mean": 1.0, "low": None, "high": None}
    assert rate([True])["low"] < 0.5
    assert mean([None]) is spread([]) is None


def test_spread_leaves_out_what_is_not_told():
    found = spread([3.0, None, 1.0, 2.0, 5.0, 4.0])
    assert (found["n"], found["q1"], found["median"], found["q3"]) == (5, 2.0, 3.0, 4.0)
    assert found["mean"] == pytest.approx(3.0)
    assert found["std"] == pytest.approx(np.sqrt(2.5))


def test_summary_of_seeds():
    results = {
        0: make_result(0, [False, True]),
        1: make_result(1, [False, False], cpu_s=20.0),
        2: make_result(2, [True, True], cpu_s=30.0),
    }
    found = summarise(results, {9: "ValueError: no luck"})
    assert [trial["experience_s"] for trial in found["trials"]] == [3.0, 6.0]
    assert [trial["success"]["rate"] for trial in found["trials"]] == [1 / 3, 2 / 3]
    assert found["trials"][1]["p"]["mean"] == pytest.approx(0.6)
    assert found["solved"]["rate"] == 2 / 3
    assert found["run"]["cpu_s"]["median"] == 40.0
    assert found["by_seed"]["1"]["success"] == [False, False]
    assert found["seeds"] == [0, 1, 2]
    assert found["failed"] == {"9": "ValueError: no luck"}
    assert len(found["machines"]) == 1
    assert json.loads(json.dumps(found)) == found


def test_table_has_a_row_a_trial_and_blanks_where_the_env_does_not_tell():
    _, told = summary_table(summarise({0: make_result(0, [True, False])}, {}))
    assert [row[0] for row in told] == ["3", "6"]
    assert [row[1] for row in told] == ["100.0 (21–100)", "0.0 (0–79)"]
    header, (row,) = summary_table(summarise({0: make_result(0, [None])}, {}))
    cells = dict(zip(header, row, strict=True))
    blank = {"success [%]", "p [%]", "time up [s]", "mean abs cart [m]"}
    assert {name for name, cell in cells.items() if not cell} == blank


def test_no_seed_gives_an_empty_table():
    found = summarise({}, {1: "lost"})
    assert summary_table(found)[1] == []
    assert summary.conclusion(found) == "Seeds: 0; failed: seed 1; no CPU seconds a training."


def test_markdown_has_a_bar_around_every_cell():
    assert summary.markdown(("a", "b"), [("1", "")]) == "| a | b |\n| --- | --- |\n| 1 |  |\n"
