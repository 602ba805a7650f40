"""The numbers of a training, of a preset and with another model."""

from __future__ import annotations

import pytest

from baselines.pilco.model import PilcoConfig
from mcpilco.agent import suitable_preset, with_model
from mcpilco.config import Config, ModelConfig
from mcpilco.plant import Correction, write_correction
from mcpilco.typing import InputError


@pytest.mark.parametrize(
    ("name", "model"),
    [
        ("mpk", ModelConfig(kernel="mpk")),
        ("features+rbf", ModelConfig(kernel="features+rbf")),
        ("sed-fir", ModelConfig(kernel="sed-fir", memory=3)),
        ("physics+rbf", ModelConfig(kernel="rbf", mean="physics")),
        ("physics+gip+rbf", ModelConfig(kernel="gip+rbf", mean="physics")),
        ("rbf+physics+mpk", ModelConfig(kernel="rbf+mpk", mean="physics")),
    ],
)
def test_a_name_is_a_sum_of_parts(name, model):
    assert with_model(Config(), name, memory=model.memory).model == model


@pytest.mark.parametrize("name", ["physics", "gauss", "rbf+", "rbf+rbf"])
def test_another_name_is_refused(name):
    with pytest.raises(InputError, match="a sum of"):
        with_model(Config(), name)


def test_a_file_says_which_plant_is_known(tmp_path):
    path = write_correction(tmp_path / "plant.json", Correction("robot", {"mass": 2.0}, ()))
    model = with_model(Config(), "physics+rbf", path, 2).model
    assert model.plant == {
        "format": 1,
        "plant": "robot",
        "parameters": {"mass": 2.0},
        "effects": [],
    }
    assert model.memory == 2
    assert with_model(Config(), delay=0.15).model.delay == 0.15
    path.write_text("{}")
    with pytest.raises(InputError, match="no correction"):
        with_model(Config(), "physics+rbf", path)


@pytest.mark.parametrize(
    ("given", "algo", "model", "preset"),
    [
        (None, "mcpilco", None, "default"),
        (None, "mcpilco", "features+rbf", "default"),
        (None, "mcpilco", "physics+gip+rbf", "thorough"),
        (None, "pilco", "physics+rbf", "default"),
        ("thesis", "mcpilco", "physics+rbf", "thesis"),
    ],
)
def test_equations_are_searched_thoroughly_unless_told(given, algo, model, preset):
    assert suitable_preset(given, algo, model) == preset


def test_algorithms_without_such_a_model_have_no_such_option():
    config = PilcoConfig()
    assert with_model(config) is config
    with pytest.raises(InputError, match="of the algorithm mcpilco"):
        with_model(config, "rbf")
