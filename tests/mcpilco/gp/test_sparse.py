from __future__ import annotations

import torch

from mcpilco.gp.gp import GP
from mcpilco.gp.sparse import subset_of_data
from mcpilco.kernels import MPK, RBF


def make(samples: int = 80, seed: int = 0) -> tuple[GP, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    X = torch.rand(samples, 2, generator=generator, dtype=torch.float64)
    gp = GP(RBF(2, (2,), lengthscale=0.3) + MPK(2, 1, (2,)), noise_std=[0.1, 0.2])
    return gp, X, torch.zeros(samples, 2, dtype=torch.float64)


def test_subset_follows_its_definition():
    """The slow way: condition anew on the kept samples for each candidate."""
    gp, X, Y = make()
    kept = [0]
    for i in range(1, len(X)):
        _, variance = gp.condition(X[kept], Y[kept]).mean_and_variance(X[i : i + 1])
        if (variance.sqrt() > 0.5 * gp.noise_std).any():
            kept.append(i)
    assert 2 < len(kept) < len(X)
    assert subset_of_data(gp, X, Y, 0.5).tolist() == kept


def test_dropped_samples_are_known_from_the_kept_ones():
    gp, X, Y = make()
    kept = subset_of_data(gp, X, Y, 0.5)
    _, variance = gp.condition(X[kept], Y[kept]).mean_and_variance(X)
    dropped = torch.ones(len(X), dtype=torch.bool)
    dropped[kept] = False
    assert dropped.any()
    assert (variance.sqrt() <= 0.5 * gp.noise_std * (1 + 1e-6))[dropped].all()


def test_threshold_zero_keeps_everything():
    gp, X, Y = make()
    assert subset_of_data(gp, X, Y, 0.0).tolist() == list(range(len(X)))


def test_higher_threshold_keeps_fewer():
    gp, X, Y = make()
    sizes = [len(subset_of_data(gp, X, Y, threshold)) for threshold in (0.2, 0.5, 1.0)]
    assert sizes[0] > sizes[1] > sizes[2]


def test_repeated_samples_are_kept_a_few_times_at_most():
    gp, X, Y = make()
    repeated = X[:1].expand(50, 2)
    assert 1 <= len(subset_of_data(gp, repeated, Y[:50], 0.5)) <= 5


def test_first_sample_stays_however_small_the_prior():
    gp, X, Y = make()
    assert subset_of_data(gp, X, Y, 1e9).tolist() == [0]
