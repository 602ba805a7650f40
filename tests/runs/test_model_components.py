from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from harness import BEGIN, END

import mcpilco.sweep
from mcpilco.config import CART_POLE
from mcpilco.sweep import Settings
from tests.mcpilco.test_sweep import HereEngine


def test_masses_are_wrong_by_up_to_a_fifth_and_only_where_a_plant_is_known(run):
    masses = np.array([list(run.wrong_masses(seed).values()) for seed in range(30)])
    errors = masses / 0.5 - 1.0
    assert np.abs(errors).max() <= run.WRONG
    assert np.abs(errors).max(0).min() > 0.8 * run.WRONG
    for name, cell in run.CELLS.items():
        config = dataclasses.replace(run.Config(), model=cell.model)
        told = run.job_of(Settings(CART_POLE, config=config), 3).args[0].config.model.plant
        knows = name.startswith(("physics", "features"))
        assert (told is not None) == knows
        assert not knows or told["parameters"] == run.wrong_masses(3)


def test_an_actuator_is_late_or_lags_as_its_cell_says(run):
    told = {name: run.disturbed(cell) for name, cell in run.CELLS.items()}
    assert told["rbf"] == {}
    (late,), (lagging,) = (told[name]["effects"]["effects"] for name in ("delay-1", "lag"))
    assert (late["name"], late["parameters"]) == ("actuator_delay", {"d": 0.1})
    assert (lagging["name"], lagging["parameters"]) == ("actuator_lag", {"T": 0.1})


@pytest.mark.slow
@pytest.mark.xdist_group("compiled")  # what it compiles
def test_quick_runs_a_seed_of_a_cell_and_goes_on(page_of_two, tmp_path, monkeypatch):
    monkeypatch.setattr(mcpilco.sweep, "LocalEngine", lambda workers: HereEngine())
    page = page_of_two("--cells", "physics+rbf", "delay-1-predicted")
    assert "| `physics+rbf` | 1 |" in page
    about = json.loads((tmp_path / "results/analytic/delay-1-predicted/sweep.json").read_text())
    assert about["env_kwargs"]["effects"]["effects"][0]["parameters"] == {"d": 0.1}
    assert about["config"]["model"]["delay"] == 0.1
    assert not (tmp_path / "results/mujoco/delay-1-predicted").exists()


def test_page_names_every_cell_and_has_its_marked_lines(run, home):
    text = (home / "README.md").read_text()
    assert text.count(BEGIN) == text.count(END) == 1
    assert all(f"`{name}`" in text.split(BEGIN)[0] for name in run.CELLS)
