"""A model that was saved is the model that is loaded; anything else is refused."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.files import read_arrays, write_arrays
from mcpilco.identification.collision import (
    ThresholdConfig,
    load_collision_model,
    save_collision_model,
    thresholds,
)
from mcpilco.typing import RunFolderError
from tests.mcpilco.identification.collision.free_arm import fitted, samples


@pytest.mark.parametrize("kind", ["PP", "FC"])
def test_what_is_loaded_is_what_was_saved(kind, tmp_path):
    model, _ = fitted(kind)
    limits = thresholds(model, samples(2), ThresholdConfig(debounce=4, by_phase=True, quantile=0.9))
    first = save_collision_model(tmp_path / "a.npz", model, limits)
    again, told = load_collision_model(first)
    test = samples(2)[:200]
    np.testing.assert_array_equal(again.mean(test), model.mean(test))
    np.testing.assert_array_equal(again.std(test), model.std(test))
    assert (again.joints, again.dt, again.config) == (model.joints, model.dt, model.config)
    assert told.config == limits.config
    np.testing.assert_array_equal(told.resting, limits.resting)
    second = save_collision_model(tmp_path / "b.npz", again, told)
    assert first.read_bytes() == second.read_bytes()


def test_what_is_no_model_is_refused(tmp_path):
    model, _ = fitted("PP")
    path = save_collision_model(tmp_path / "m.npz", model, thresholds(model, samples(2)))
    arrays = read_arrays(path)
    with pytest.raises(RunFolderError, match="There is no file"):
        load_collision_model(tmp_path / "none.npz")
    write_arrays(path, {name: array for name, array in arrays.items() if "limits" not in name})
    with pytest.raises(RunFolderError, match="damaged"):
        load_collision_model(path)
    write_arrays(path, {**arrays, "limits/moving": np.zeros(2)})
    with pytest.raises(RunFolderError, match="damaged"):
        load_collision_model(path)
    write_arrays(path, {**arrays, "about": np.array('{"format": "policy"}')})
    with pytest.raises(RunFolderError, match="no model of `mcpilco collisions learn`"):
        load_collision_model(path)
