from __future__ import annotations

import numpy as np
import pytest

from mcpilco.sweep import read_run
from mcpilco.sweep.statistics import (
    all_amounts,
    common_amounts,
    difference,
    differences,
    estimate,
    estimates,
    measure_of,
)
from tests.mcpilco.sweep.folders import trials_of, write_sweep


def test_interquartile_mean_is_that_of_the_middle_half():
    values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 70.0, -900.0]
    found = estimate(values, measure_of("time_up_s"), "iqm")
    assert found.value == pytest.approx(np.mean([2.0, 3.0, 4.0, 5.0]))
    assert found.seeds == 8
    assert estimate(values, measure_of("time_up_s"), "median").value == 3.5


@pytest.mark.parametrize(
    "statistic", ["mean", pytest.param("median", marks=pytest.mark.slow), "iqm"]
)
def test_intervals_cover_the_truth_at_about_their_level(statistic):
    """All three estimate the middle of a symmetric distribution."""
    rng, covered = np.random.default_rng(0), 0
    for _ in range(100):
        found = estimate(rng.normal(5.0, 2.0, 20), measure_of("time_up_s"), statistic)
        covered += found.low <= 5.0 <= found.high
    assert 85 <= covered < 100


def test_shares_are_percent_and_have_wilsons_interval_where_seeds_say_yes_or_no():
    found = estimate([1.0] * 10, measure_of("success"), "mean")
    z = 1.959963984540054
    assert (found.value, found.high) == (100.0, 100.0)
    assert found.low == pytest.approx(100 * 10 / (10 + z**2))
    assert estimate([0.5, 0.7], measure_of("p"), "mean").value == pytest.approx(60.0)


def test_one_seed_has_no_interval_and_none_no_estimate():
    found = estimate([3.0], measure_of("time_up_s"), "iqm")
    assert (found.value, found.low, found.high) == (3.0, None, None)
    assert estimate([], measure_of("time_up_s"), "iqm") is None


def make_run(path, times, **rows):
    """A run of one trial a seed, with these times up."""
    seeds = {seed: trials_of([0.5], **rows, time_up_s=value) for seed, value in times.items()}
    return read_run(write_sweep(path, seeds))


def test_differences_are_taken_seed_by_seed(tmp_path):
    """What seeds do to both alike drops out, however much it is."""
    luck = 100.0 * np.random.default_rng(0).standard_normal(20)
    one = make_run(tmp_path / "a", dict(enumerate(luck)))
    two = make_run(tmp_path / "b", dict(enumerate(luck + 0.25)) | {30: 1e9})
    found = difference(two, one, measure_of("time_up_s"), 3.0)
    assert found.seeds == 20
    assert (found.low, found.value, found.high) == pytest.approx((0.25, 0.25, 0.25))
    apart = estimate(list(one.at(3.0, "time_up_s").values()), measure_of("time_up_s"), "iqm")
    assert apart.high - apart.low > 10.0


def test_every_pair_is_compared_at_the_amounts_that_both_have(tmp_path):
    runs = [
        read_run(write_sweep(tmp_path / name, {0: trials_of([0.1] * 3, after=after)}))
        for name, after in {"a": 3.0, "b": 3.001, "c": 6.0, "d": 5.0}.items()
    ]
    rows = [row for row in differences(runs) if row.measure.key == "return"]
    found = {(row.run, row.other): [] for row in rows}
    for row in rows:
        found[row.run, row.other].append(row.experience_s)
    assert found == {("b", "a"): [3.0, 6.0, 9.0], ("c", "a"): [6.0], ("c", "b"): [6.002]}
    assert common_amounts(runs[:3]) == [6.0]
    assert all_amounts(runs[:3]) == [3.0, 6.0, 9.0, 12.0, 18.0]


def test_nothing_is_told_of_seeds_that_runs_do_not_share(tmp_path):
    runs = [make_run(tmp_path / str(seed), {seed: 1.0}) for seed in range(2)]
    assert differences(runs) == []
    assert {row.run for row in estimates(runs)} == {"0", "1"}
