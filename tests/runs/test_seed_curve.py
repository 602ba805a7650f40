"""Seeds judged after amounts of experience."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
from cartpole_comparison import seed_curve
from cartpole_comparison.seed_curve import CurveJob, CurveSettings

from mcpilco.sweep import SweepFolder, read_run, sweep
from mcpilco.typing import InputError
from tests.baselines.pilco.models import TINY
from tests.mcpilco.sweep.strange import HERE, HORIZON
from tests.mcpilco.test_sweep import HereEngine

SETTINGS = CurveSettings(
    f"{HERE}:Sweep/Point-v0",
    config=dataclasses.replace(TINY, horizon=HORIZON),
    algo="baselines:pilco",
    trials=3,
    amounts=(2 * HORIZON, 3 * HORIZON, 5 * HORIZON),
    fresh=4,
)


def without_times(rows):
    return [{k: v for k, v in row.items() if k not in ("cpu_s", "wall_s")} for row in rows]


def test_a_seed_has_a_row_for_each_amount(tmp_path):
    result = CurveJob(SETTINGS, 3, tmp_path)()
    assert [row["trial"] for row in result["trials"]] == [1, 2, 3]
    # a rollout less than the amounts: the last one tried the policy
    seconds = [row["experience_s"] for row in result["trials"]]
    np.testing.assert_allclose(seconds, [0.5, 1.0, 2.0])
    assert all(row["cpu_s"] > 0 for row in result["trials"])
    assert all(np.isfinite(row["fresh_return"]) for row in result["trials"])


@pytest.mark.slow
@pytest.mark.parametrize(("done", "saved"), [(1, True), (2, False)])
def test_a_seed_that_was_stopped_ends_as_if_it_never_was(tmp_path, monkeypatch, done, saved):
    whole = CurveJob(SETTINGS, 3, tmp_path / "whole")()
    write = seed_curve.write_json

    def stop(path, content):
        if len(content["rows"]) == done + (not saved):
            if saved:
                write(path, content)
            raise KeyboardInterrupt
        write(path, content)

    job = CurveJob(SETTINGS, 3, tmp_path / "pieces")
    with monkeypatch.context() as patch:
        patch.setattr(seed_curve, "write_json", stop)
        with pytest.raises(KeyboardInterrupt):
            job()
    again = job()
    assert without_times(again["trials"]) == without_times(whole["trials"])
    assert again["trials"][done - 1]["cpu_s"] > 0
    job.forget()
    assert not any((tmp_path / "pieces").iterdir())


def test_the_test_rollout_is_none_of_the_fresh_ones():
    """Of one test rollout and four fresh ones, only the first is a success."""
    found = seed_curve.Judgement(
        3.0,
        7.0,
        {
            "return": np.array([9.0, 1, 2, 3, 4]),
            "reach_m": np.arange(5.0),
            "is_success": np.array([1.0, 0, 0, 0, 0]),
        },
        8.0,
    )
    row = seed_curve._row(1, found, seed_curve.Judgement(1.5, 2.0, {}, 2.5))
    assert (row["success"], row["p"], row["return"], row["fresh_return"]) == (True, 0.0, 9.0, 2.5)
    assert (row["cpu_s"], row["wall_s"], row["reach_m"]) == (5.0, 5.5, 0.0)


def test_it_is_swept_and_compared_as_others_are(tmp_path):
    make_job = functools.partial(CurveJob, checkpoints=tmp_path / "checkpoints")
    for _ in range(2):  # the second one opens what is there
        summary = sweep(SETTINGS, [0, 1], tmp_path / "sweep", HereEngine(), make_job=make_job)
    assert summary["seeds"] == [0, 1]
    assert list(SweepFolder(tmp_path / "sweep", SETTINGS).results()) == [0, 1]
    run = read_run(tmp_path / "sweep")
    assert run.algo == "pilco"
    np.testing.assert_allclose(run.amounts, [0.5, 1.0, 2.0])


def test_amounts_are_as_many_as_trials():
    with pytest.raises(InputError, match="trials must be the number of amounts, 3, got 2"):
        dataclasses.replace(SETTINGS, trials=2)
