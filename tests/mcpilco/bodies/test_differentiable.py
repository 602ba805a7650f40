from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch

from mcpilco.bodies.differentiable import torch_regressor
from mcpilco.bodies.motion import regressor
from mcpilco.mjcf import chain_of
from tests.mcpilco.random_chains import random_mjcf


@pytest.mark.parametrize("seed", range(5))
def test_regressor_is_the_compiled_one(seed):
    """Of trees of hinges and slides, of which some share a body."""
    rng = np.random.default_rng(seed)
    chain = chain_of(mujoco.MjModel.from_xml_string(random_mjcf(rng, 5)))
    q, dq, ddq = rng.normal(size=(3, 6, 5))
    motion = torch.as_tensor(np.concatenate([q, dq, ddq], 1)).reshape(2, 3, 15)
    found = torch_regressor(chain, motion).reshape(6, 5, 5, 10)
    np.testing.assert_allclose(found, regressor(chain, q, dq, ddq), rtol=1e-11, atol=1e-11)


def test_regressor_is_differentiable():
    rng = np.random.default_rng(0)
    chain = chain_of(mujoco.MjModel.from_xml_string(random_mjcf(rng, 3)))
    motion = torch.as_tensor(rng.normal(size=(2, 9))).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: torch_regressor(chain, x), motion)
