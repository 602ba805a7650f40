from __future__ import annotations

import numpy as np

import envs
from mcpilco.config import CART_POLE
from mcpilco.plant import corrected, correction_from


def settings_of(run, system, name):
    from mcpilco.config import Config
    from mcpilco.sweep import Settings

    return Settings(f"envs:{CART_POLE}", {}, name, Config(model=run.MODELS[name]), 1, 1)


def test_the_systems_have_forces_that_their_models_lack(run):
    for system, effects in run.SYSTEMS.items():
        plant = corrected(envs.PLANTS[CART_POLE](), correction_from(run.described({}, effects)))
        assert bool(plant.added) == (system != "links")
        job = run.job_of(system, settings_of(run, system, "physics+gip+rbf"), 3)
        model = job.args[0].config.model
        assert model.plant["effects"] == []
        assert (model.uncertainty == 0.0) == (system == "links")


def test_of_unknown_links_no_number_is_right(run):
    true = envs.PLANTS[CART_POLE]().values
    assert all(np.isclose(value, 2.0 * true[name]) for name, value in run.UNKNOWN.items())
