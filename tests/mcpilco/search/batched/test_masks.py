"""The masks of a batch are the masks of `mcpilco.policies.dropout`."""

from __future__ import annotations

import pytest
import torch

from mcpilco.policies import Dropout
from mcpilco.search.batched.masks import MaskBatch


@pytest.mark.parametrize("bases", [1, 4, 33])
def test_each_seed_has_the_mask_that_it_has_alone(bases: int) -> None:
    dropouts = [Dropout(0.25, 2**31 - 1), None, Dropout(0.5, 0)]
    masks = MaskBatch.of(dropouts, 7)
    assert masks is not None
    for step in range(7):
        factors = masks.factors(step, 50, bases)
        for seed, dropout in enumerate(dropouts):
            alone = torch.ones(50, bases).double()
            if dropout is not None:
                alone = dropout.factors(step, 50, bases)
            assert torch.equal(factors[seed], alone)


def test_no_dropout_is_no_mask() -> None:
    assert MaskBatch.of([None, None], 7) is None
