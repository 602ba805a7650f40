"""Laws of an exported policy: numpy alone, with the lines of the documentation, does the same."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch

import envs  # noqa: F401  registers the cart-pole
from mcpilco.agent.agent import MCPILCO
from mcpilco.agent.numpy_policy import NumpyPolicy
from mcpilco.agent.policy_file import write_policy
from mcpilco.cli import main
from mcpilco.config import PRESETS, Limit, ModelConfig
from mcpilco.policies import SumOfGaussians
from mcpilco.typing import InputError
from tests.mcpilco.cli.test_cli import refused
from tests.mcpilco.conftest import make_policy
from tests.mcpilco.point import STEPS, TASK, TINY, PointEnv
from tests.mcpilco.survival import train

PAGE = Path(__file__).parents[3] / "docs" / "getting-started.md"


def predict_of_the_page(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """The function that the page defines, beside the `policy.npz` in a folder."""
    monkeypatch.chdir(folder)
    block = re.search(r'```python title="act.py"\n(.*?)^print', PAGE.read_text(), re.M | re.S)[1]
    assert "mcpilco" not in block
    assert "torch" not in block
    assert len(block.split("def predict")[1].strip().splitlines()) <= 12
    namespace: dict[str, Any] = {}
    exec(block, namespace)
    return namespace["predict"]


def answer(policy: SumOfGaussians, observations: np.ndarray) -> np.ndarray:
    with torch.no_grad():
        return policy(torch.from_numpy(observations)).numpy()


@pytest.mark.parametrize("inputs", [1, 2])
def test_numpy_and_torch_agree(task, tmp_path: Path, monkeypatch, inputs: int) -> None:
    policy = make_policy(task, inputs=inputs)
    write_policy(tmp_path / "policy.npz", policy, task)
    predict = predict_of_the_page(tmp_path, monkeypatch)
    observations = np.random.default_rng(0).normal(scale=2, size=(500, 4))
    expected = answer(policy, observations)
    assert np.abs(expected).max() > 2  # the policy does something
    np.testing.assert_allclose(predict(observations), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(predict(observations[3]), expected[3], rtol=0, atol=1e-12)


def test_a_state_without_angles_is_acted_on_too(tmp_path: Path, monkeypatch) -> None:
    agent = MCPILCO("SumOfGaussians", PointEnv(), config=TINY).learn(2 * STEPS)
    write_policy(tmp_path / "policy.npz", agent.policy, agent.task)
    predict = predict_of_the_page(tmp_path, monkeypatch)
    observations = np.random.default_rng(0).normal(size=(50, 2))
    expected = answer(agent.policy, observations)
    np.testing.assert_allclose(predict(observations), expected, rtol=0, atol=1e-12)
    np.testing.assert_allclose(predict(observations), agent.predict(observations)[0], atol=1e-6)


def test_the_file_says_what_its_numbers_are(tmp_path: Path) -> None:
    policy = make_policy(TASK)
    with np.load(write_policy(tmp_path / "policy.npz", policy, TASK)) as file:
        assert file["state_names"].tolist() == list(TASK.state_names)
        assert file["input_units"].tolist() == list(TASK.input_units)
        assert float(file["dt"]) == TASK.dt


def test_the_command_writes_the_trial_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    default = dataclasses.replace(PRESETS["default"], config=TINY)
    monkeypatch.setitem(PRESETS, "default", default)
    run, file = tmp_path / "run", tmp_path / "policy.npz"
    assert main(train(run, trials=2)) == 0
    capsys.readouterr()
    for trial, asked in ((1, ["--trial", "1"]), (2, [])):
        assert main(["export", str(run), str(file), *asked]) == 0
        assert f"Policy of trial {trial}: {file}" in capsys.readouterr().out
        with np.load(file) as found, np.load(run / f"trials/0{trial}/policy.npz") as expected:
            np.testing.assert_array_equal(found["weights"], expected["weights"])
    sentence = refused(capsys, "export", str(run), str(file), "--trial", "3")
    assert "--trial must be one of 1, 2, got 3" in sentence
    sentence = refused(capsys, "export", str(run), str(tmp_path / "no" / "policy.npz"))
    assert "Cannot write" in sentence


# --- with an estimator ----------------------------------------------------------------------------

ALL, POSITIONS = "mcpilco/CartPoleSwingUp-v0", "mcpilco/CartPoleSwingUpPositions-v0"


RAIL = Limit("cart_position", -0.5, 0.5)


PHYSICS = {"kernel": "rbf", "mean": "physics"}


def learned(env: str, limits: tuple[Limit, ...] = (), regulator: float = 0.0, **model) -> MCPILCO:
    search = dataclasses.replace(TINY.search, limits=limits)
    policy = dataclasses.replace(TINY.policy, regulator=regulator)
    config = dataclasses.replace(
        TINY, search=search, policy=policy, model=ModelConfig(**model), horizon=9
    )
    config = dataclasses.replace(config, exploration=27 if limits else None)
    agent = MCPILCO("SumOfGaussians", gym.make(env, max_episode_steps=9), config=config, seed=4)
    return agent.learn(agent.timesteps_of(1))


@pytest.mark.one_in(5)
@pytest.mark.parametrize(
    ("env", "model"),
    [
        (ALL, {"kernel": "rbf"}),
        (ALL, {"kernel": "sed-mpk+rbf", "memory": 2}),
        (POSITIONS, {"kernel": "rbf+mpk"}),
        (ALL, {"kernel": "rbf+mpk", "delay": 0.2}),
        (ALL, {"kernel": "rbf", "delay": 0.13}),
        (POSITIONS, {"kernel": "rbf", "delay": 0.1}),
        (ALL, {"kernel": "rbf", "limits": (RAIL,)}),
        (ALL, {"kernel": "sed-mpk+rbf", "memory": 2, "limits": (RAIL,)}),
        (ALL, PHYSICS | {"regulator": 20.0}),
        (POSITIONS, PHYSICS | {"regulator": 20.0}),
        (ALL, PHYSICS | {"regulator": 20.0, "memory": 1, "limits": (RAIL,)}),
    ],
)
def test_numpy_alone_acts_as_the_agent_with_its_estimator(env: str, model, tmp_path: Path) -> None:
    """Episodes of states measured in part, of past inputs, and of late actuators."""
    agent = learned(env, **model)
    path = write_policy(tmp_path / "policy.npz", agent.policy, agent.task, agent.estimator)
    policy = NumpyPolicy(path)
    source = Path(__file__).parents[3] / "mcpilco" / "agent" / "numpy_policy.py"
    imports = re.findall(r"^(?:from|import) (\w+)", source.read_text(), re.M)
    assert set(imports) == {"__future__", "collections", "pathlib", "typing", "numpy"}
    width = agent.env.observation_space.shape[0]
    for seed in range(2):  # the second episode knows nothing of the first
        act, remembers = agent.on_states(), []
        policy.reset()
        for x in 0.3 * np.random.default_rng(seed).normal(size=(7, width)).cumsum(0):
            expected = act(x)
            np.testing.assert_allclose(policy(x), expected, rtol=1e-6, atol=1e-7)
            remembers.append(np.abs(expected - answer(agent.policy, _as_first(agent, x))).max())
        assert (max(remembers) > 1e-3) == (agent.estimator is not None)


def _as_first(agent: MCPILCO, x: np.ndarray) -> np.ndarray:
    """The state that the policy acts on where a measurement is the first of an episode."""
    if agent.estimator is None:
        return x
    measured = torch.from_numpy(x)
    return agent.estimator.observe(measured, agent.estimator.begin(measured))[0].numpy()


def test_a_late_actuators_model_with_features_is_not_exported(tmp_path: Path) -> None:
    agent = learned(ALL, kernel="friction+rbf", delay=0.1)
    with pytest.raises(InputError, match="further regressors.*act with `agent.predict`"):
        write_policy(tmp_path / "policy.npz", agent.policy, agent.task, agent.estimator)
