"""Presets in files like those of rl-baselines3-zoo."""

from __future__ import annotations

import dataclasses
import inspect

import pytest

import envs  # noqa: F401  registers its ids
from baselines.sb3 import PPOAgent, SACAgent, SACConfig, TQCAgent
from baselines.sb3.config import read_presets
from baselines.sb3.library import CLASSES
from mcpilco.config import from_dict
from mcpilco.typing import InputError

KINDS = (SACAgent, TQCAgent, PPOAgent)
IDS = (
    "mcpilco/CartPoleSwingUp-v0",
    "mcpilco/MujocoCartPoleSwingUp-v0",
    "mcpilco/Pendulum-v0",
)


@pytest.mark.parametrize("kind", KINDS)
def test_the_shipped_presets_name_the_envs_of_this_package(kind):
    assert set(IDS) <= set(kind.presets["default"].by_env)


@pytest.mark.parametrize("kind", KINDS)
def test_entries_are_arguments_of_the_library(kind):
    known = inspect.signature(CLASSES[kind.algo]).parameters
    for config in (kind.config_type(), *kind.presets["default"].by_env.values()):
        assert set(config.keywords()) <= set(known)


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_survive_json(kind):
    config = kind.presets["default"].config_for(IDS[0])
    assert from_dict(kind.config_type, dataclasses.asdict(config)) == config


@pytest.mark.parametrize("kind", KINDS)
def test_the_learner_is_made_with_the_numbers_of_its_env(kind):
    agent = kind("MlpPolicy", IDS[0])
    for name in ("gamma", "learning_rate", "batch_size"):
        assert getattr(agent.learner, name) == getattr(agent.config, name)
    assert agent.learner.n_envs == agent.config.n_envs


def test_an_env_of_another_module_has_its_own_numbers(tmp_path):
    preset = SACAgent.presets["default"]
    assert preset.config_for(f"envs:{IDS[0]}") is preset.by_env[IDS[0]]
    assert preset.config_for("Own/Env-v0") is preset.config


def test_a_file_of_the_zoo_is_read(tmp_path):
    path = tmp_path / "sac.yml"
    path.write_text(
        "Own/Env-v0:\n  n_timesteps: !!float 2e4\n  policy: 'MlpPolicy'\n  learning_rate: 1.0e-3\n"
        "  gamma: 0.9\n  use_sde: True\n  train_freq: 8\n  gradient_steps: 8\n"
        "  policy_kwargs:\n    net_arch: [32, 32]\n    log_std_init: -3\n"
    )
    found = read_presets(path, SACConfig)["Own/Env-v0"]
    assert (found.n_timesteps, found.gamma, found.policy_kwargs.net_arch) == (20000, 0.9, (32, 32))
    assert found.keywords()["policy_kwargs"]["log_std_init"] == -3


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("Env-v0: {gama: 0.9}", "no entries \\['gama'\\]"),
        ("Env-v0: {learning_rate: fast}", "must be of type float"),
        ("Env-v0: {learning_rate: -1.0}", "must be positive"),
        ("Env-v0: {trial_steps: 25, n_envs: 2}", "multiple of the 2 steps"),
        ("Env-v0: {ent_coef: automatic}", "ent_coef must be a number, auto"),
        ("Env-v0: {policy_kwargs: {net_arch: [0]}}", "at least 1 unit"),
        ("Env-v0: 3", "must be an object"),
        ("- 3", "entries under env ids"),
        ("a: [", "is no YAML"),
        ("Env-v0: {policy_kwargs: !!python/object/apply:os.getcwd []}", "is no YAML"),
    ],
)
def test_wrong_files_are_refused(tmp_path, text, sentence):
    path = tmp_path / "sac.yml"
    path.write_text(text)
    with pytest.raises(InputError, match=sentence):
        read_presets(path, SACConfig)


def test_a_file_that_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_presets(tmp_path / "sac.yml", SACConfig)
