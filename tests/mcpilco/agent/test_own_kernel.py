"""A kernel of a user's own: the agent learns with it, is saved, and is loaded with it again."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest
import torch

from mcpilco.agent import MCPILCO
from mcpilco.kernels import RBF, Kernel, Positive
from mcpilco.search import engine
from mcpilco.typing import InputError, RunFolderError
from tests.mcpilco.point import STEPS, TINY, PointEnv


class Rational(Kernel):
    """k(x, x') = variance / (1 + |(x - x') / lengthscale|^2): one formula, one method."""

    variance, lengthscale = Positive(), Positive()

    def __init__(self, width, batch=()):
        super().__init__(width, batch)
        self.variance, self.lengthscale = self.spread(1.0), self.spread(1.0, width)

    def forward(self, X1, X2):
        apart = X1[..., :, None, :] - X2[..., None, :, :]
        squares = (apart / self.lengthscale[..., None, None, :]).square().sum(-1)
        return self.variance[..., None, None] / (1 + squares)


class Other(Rational):
    """The same under another name."""


def make_agent(kernel=Rational, **model) -> MCPILCO:
    config = dataclasses.replace(TINY, model=dataclasses.replace(TINY.model, **model))
    return MCPILCO("SumOfGaussians", PointEnv(), config=config, seed=1, kernel=kernel)


@pytest.fixture(scope="module")
def learned() -> MCPILCO:
    return make_agent().learn(3 * STEPS)


@pytest.fixture(scope="module")
def saved(learned, tmp_path_factory):
    return learned.save(tmp_path_factory.mktemp("own") / "agent.npz")


def test_an_agent_learns_with_it_and_warns_that_it_is_slower(caplog):
    engine._warn_once.cache_clear()
    config = dataclasses.replace(TINY, engine="fused")
    agent = MCPILCO("SumOfGaussians", PointEnv(), config=config, kernel=Rational)
    with caplog.at_level(logging.WARNING):
        agent.learn(2 * STEPS)
    assert isinstance(agent.model.gp.kernel, Rational)
    assert agent.results[0].failure is None
    assert np.isfinite(agent.results[0].predicted_cost)
    assert "Rational has no canonical form" in caplog.text
    assert "plain torch" in caplog.text


def test_its_hyperparameters_are_learned(learned):
    fresh = make_agent()
    mine, its = (agent.model.gp.kernel.lengthscale.detach() for agent in (learned, fresh))
    assert not torch.allclose(mine, its)


def test_the_saved_agent_is_loaded_with_it_and_learns_on(learned, saved):
    again = MCPILCO.load(saved, PointEnv(), kernel=Rational)
    state = np.array([0.3, -0.2])
    np.testing.assert_array_equal(again.predict(state)[0], learned.predict(state)[0])
    for name, array in learned.model.to_arrays().items():
        np.testing.assert_array_equal(again.model.to_arrays()[name], array)
    assert again.learn(STEPS).trials == 3


@pytest.mark.parametrize("kernel", [None, Other])
def test_the_saved_agent_is_refused_without_it(saved, kernel):
    objects = {} if kernel is None else {"kernel": kernel}
    with pytest.raises(RunFolderError, match="give `load` the same one: kernel=Rational"):
        MCPILCO.load(saved, PointEnv(), **objects)


def test_an_agent_with_a_kernel_of_its_configuration_takes_no_other(tmp_path):
    path = make_agent(None).save(tmp_path / "agent.npz")
    with pytest.raises(RunFolderError, match="load it without `kernel`"):
        MCPILCO.load(path, PointEnv(), kernel=Rational)


def test_a_function_may_make_it():
    agent = make_agent(lambda width, batch: RBF(width, batch) + Rational(width, batch))
    assert agent.learn(2 * STEPS).results[0].failure is None


@pytest.mark.parametrize(
    ("kernel", "sentence"),
    [
        (lambda width, batch: None, "that makes a NoneType"),
        (lambda width, batch: Rational(width + 1, batch), "must make a kernel of width"),
        (Rational, "no paths to draw"),
    ],
)
def test_what_does_not_fit_is_refused(kernel, sentence):
    with pytest.raises(InputError, match=sentence):
        make_agent(kernel, **({"sampling": "path"} if kernel is Rational else {}))
