"""What the kernels of forward kinematics can represent, on arms that they know nothing of."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import torch

from envs.arms.dh import Link
from envs.arms.marked import marked_arm
from mcpilco.kernels import Kinematic, NestedKinematic
from mcpilco.typing import InputError

CHAINS = list(itertools.product(("hinge", "slide"), repeat=3))


def regressors(q: np.ndarray, kinds: tuple[str, ...]) -> torch.Tensor:
    turns = [k for k, kind in enumerate(kinds) if kind == "hinge"]
    slides = [k for k, kind in enumerate(kinds) if kind == "slide"]
    parts = np.cos(q[:, turns]), np.sin(q[:, turns]), q[:, slides]
    return torch.as_tensor(np.concatenate(parts, axis=1))


@pytest.mark.parametrize("kernel", [Kinematic, NestedKinematic])
@pytest.mark.parametrize("kinds", CHAINS, ids=lambda kinds: "".join(k[0] for k in kinds))
def test_every_pose_of_every_chain_is_in_the_span(kernel, kinds) -> None:
    rng = np.random.default_rng(0)
    links = [Link(kind, *rng.uniform(-1.0, 1.0, 4)) for kind in kinds]
    arm = marked_arm(links, rng)
    q = rng.uniform(-1.5, 1.5, (120, 3))
    positions, orientations = arm.poses(q)
    matrices = orientations.as_matrix().reshape(120, 4, 9)[:, -1]
    Y = torch.as_tensor(np.concatenate([positions[:, -1], matrices], axis=1))
    X = regressors(q, kinds)
    k = kernel(kinds)
    K = k(X, X[:60])
    coefficients = torch.linalg.lstsq(K[:60], Y[:60], driver="gelsd", rcond=1e-11).solution
    torch.testing.assert_close(K[60:] @ coefficients, Y[60:], rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("kinds", CHAINS, ids=lambda kinds: "".join(k[0] for k in kinds))
def test_as_many_monomials_as_the_proposition_counts(kinds) -> None:
    X = torch.randn(200, 6, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    R, P = kinds.count("hinge"), kinds.count("slide")
    X = X[:, : 2 * R + P]
    rank = int(torch.linalg.matrix_rank(Kinematic(kinds)(X, X), rtol=1e-12))
    nested = int(torch.linalg.matrix_rank(NestedKinematic(kinds)(X, X), rtol=1e-12))
    assert rank == 3**R * (1 + P)
    assert nested <= rank


def test_unknown_joints_are_refused() -> None:
    with pytest.raises(InputError, match="hinge or slide, one at least, got ball"):
        Kinematic(("hinge", "ball"))
    with pytest.raises(InputError, match="got none"):
        NestedKinematic(())
