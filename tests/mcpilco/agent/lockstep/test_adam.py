"""A batch of Adams is one Adam a seed."""

from __future__ import annotations

import math

import pytest
import torch

from mcpilco.agent.lockstep.adam import AdamBatch, clipped

RATES = (0.1, 0.03, 0.01)


def gradients(step: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(step)
    return torch.randn(3, 5, generator=generator, dtype=torch.float64)


def test_each_seed_goes_as_torch_goes_and_stays_where_its_gradient_is_not_usable() -> None:
    start = gradients(100)
    batch = AdamBatch(start.clone())
    alone = [torch.nn.Parameter(row.clone()) for row in start]
    optimisers = [torch.optim.Adam([row], lr) for row, lr in zip(alone, RATES, strict=True)]
    for step in range(30):
        gradient = gradients(step)
        usable = torch.tensor([(step + seed) % 4 != 0 for seed in range(3)])
        gradient[~usable] = math.nan
        batch.step(gradient, torch.tensor(RATES, dtype=torch.float64), usable)
        for seed in usable.nonzero().flatten().tolist():
            alone[seed].grad = gradient[seed].clone()
            optimisers[seed].step()
        expected = torch.stack([row.detach() for row in alone])
        torch.testing.assert_close(batch.numbers, expected, rtol=1e-12, atol=1e-14)


def test_seeds_that_stay_keep_their_history() -> None:
    full, part = AdamBatch(gradients(100)), AdamBatch(gradients(100))
    rate, usable = torch.tensor(RATES, dtype=torch.float64), torch.ones(3, dtype=torch.bool)
    full.step(gradients(0), rate, usable)
    part.step(gradients(0), rate, usable)
    rows = [0, 2]
    part.keep(rows)
    full.step(gradients(1), rate, usable)
    part.step(gradients(1)[rows], rate[rows], usable[rows])
    assert torch.equal(part.numbers, full.numbers[rows])


@pytest.mark.parametrize("limit", [None, 1.5, 1e3])
def test_each_seed_is_clipped_as_torch_clips(limit: float | None) -> None:
    found, norms = clipped(gradients(0), limit)
    for mine, norm, gradient in zip(found, norms, gradients(0), strict=True):
        parameter = torch.nn.Parameter(torch.zeros(5, dtype=torch.float64))
        parameter.grad = gradient.clone()
        expected = torch.nn.utils.clip_grad_norm_([parameter], limit or math.inf)
        torch.testing.assert_close(norm, expected, rtol=1e-14, atol=0)
        torch.testing.assert_close(mine, parameter.grad, rtol=1e-14, atol=0)
