from __future__ import annotations

import numpy as np
import pytest

import envs
from mcpilco.identification import correction_of_identified


def test_a_drawing_is_wrong_by_up_to_a_fifth_in_its_masses_alone(run):
    true = envs.PLANTS[run.PLANT]().values
    errors = []
    for seed in range(30):
        drawn = run.drawn(seed).values
        assert {n for n in true if drawn[n] != true[n]} <= set(run.MASSES)
        errors.append([drawn[m] / true[m] - 1.0 for m in run.MASSES])
    assert np.abs(errors).max() <= run.WRONG
    assert np.abs(errors).max(0).min() > 0.8 * run.WRONG


@pytest.mark.parametrize("name", ["least-squares", pytest.param("eiv", marks=pytest.mark.slow)])
def test_without_noise_recordings_tell_the_forces_of_the_arm(run, monkeypatch, name):
    monkeypatch.setattr(run, "NOISE", 1e-5)
    drawing = run.drawn(1000)
    found = run.identified(drawing, run.PRIORS[name], 1000)
    assert max(run.wrong_by(found)) < 0.02
    assert correction_of_identified(drawing, found).spread


def test_the_table_has_a_row_a_prior_and_differences_of_equal_seeds(run):
    def result(seed, *shares):
        trials = [{"experience_s": 2.5 * (k + 1), "p": p} for k, p in enumerate(shares)]
        return {"seed": seed, "trials": trials, "error": [0.1, 0.3]}

    found = {
        "drawing": [result(1, 0.5, 0.5), result(2, 0.0, 0.5)],
        "eiv": [result(1, 1.0, 1.0)],
    }
    assert "| `eiv` | 1 | 30 (30–30) | 100.0" in run.table(found)
    assert "| `drawing` | 1 | 50.0" in run.against(found)
