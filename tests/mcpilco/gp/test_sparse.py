"""Laws of many samples through few."""

from __future__ import annotations

import torch

from mcpilco.gp import GP, Samples, condition_through, inducing_points, subset_of_data
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


def noisy(samples: int = 80, seed: int = 0) -> tuple[GP, torch.Tensor, torch.Tensor]:
    gp, X, _ = make(samples, seed)
    draws = torch.randn(samples, 2, generator=torch.Generator().manual_seed(1), dtype=X.dtype)
    L = torch.linalg.cholesky(gp.covariance(X).detach())
    return gp, X, (L @ draws.mT[..., None]).squeeze(-1).mT


def queries() -> torch.Tensor:
    return make(50, seed=2)[1]


def test_through_all_samples_the_posterior_is_exact():
    gp, X, Y = noisy(40)
    through = condition_through(gp, X, Y, torch.arange(40))
    exact = gp.condition(X, Y)
    for here, there in zip(
        through.mean_and_variance(queries()), exact.mean_and_variance(queries()), strict=True
    ):
        torch.testing.assert_close(here, there, rtol=1e-5, atol=1e-6)
    more = Samples(queries()[:3], Y[:3], torch.ones(3, dtype=torch.bool))
    torch.testing.assert_close(
        through.after(more).mean(X), exact.after(more).mean(X), rtol=1e-5, atol=1e-5
    )


def test_through_few_samples_it_follows_its_definition():
    """Moments of the function at the queries, from the joint Gaussian of FITC written out."""
    gp, X, Y = noisy()
    kept = inducing_points(gp, X, Y, most=12)
    mean, variance = condition_through(gp, X, Y, kept).mean_and_variance(queries())
    Z, k = X[kept], lambda a, b: gp.kernel(a, b).detach()
    prior = k(Z, Z)
    Q = k(Z, X).mT @ torch.linalg.solve(prior, k(Z, X))
    left = gp.kernel.diag(X).detach() - Q.diagonal(dim1=-2, dim2=-1)
    noisy_Q = Q + torch.diag_embed(gp.noise_std.detach().square()[:, None] + left)
    q = k(Z, queries()).mT @ torch.linalg.solve(prior, k(Z, X))  # E M N
    expected = (q @ torch.linalg.solve(noisy_Q, Y.mT[..., None])).squeeze(-1).mT
    torch.testing.assert_close(mean, expected, rtol=1e-6, atol=1e-8)
    explained = (q * torch.linalg.solve(noisy_Q, q.mT).mT).sum(-1)
    torch.testing.assert_close(
        variance.mT, gp.kernel.diag(queries()).detach() - explained, rtol=1e-5, atol=1e-8
    )


def test_it_knows_more_than_the_subset():
    gp, X, Y = noisy()
    kept = inducing_points(gp, X, Y, most=8)
    subset, through = (
        posterior.mean_and_variance(queries())[1]
        for posterior in (gp.condition(X[kept], Y[kept]), condition_through(gp, X, Y, kept))
    )
    assert (through < subset * (1 + 1e-9)).all()
    assert (through < 0.9 * subset).any()


def test_its_errors_are_as_large_as_it_says():
    """Functions drawn from the prior, seen at many samples, predicted through very few."""
    gp, X, _ = make(300)
    at, few = queries(), inducing_points(gp, X, torch.zeros(300, 2), most=10)
    everywhere = gp.kernel(torch.cat([X, at]), torch.cat([X, at])).detach()
    L = torch.linalg.cholesky(everywhere + 1e-9 * torch.eye(350, dtype=X.dtype))
    generator, squares = torch.Generator().manual_seed(3), []
    for _ in range(40):
        f = (L @ torch.randn(2, 350, 1, generator=generator, dtype=X.dtype)).squeeze(-1).mT
        noise = torch.randn(300, 2, generator=generator, dtype=X.dtype) * gp.noise_std.detach()
        mean, variance = condition_through(gp, X, f[:300] + noise, few).mean_and_variance(at)
        squares.append((mean - f[300:]).square() / variance)
    assert 0.7 < float(torch.stack(squares).mean()) < 1.3


def test_factors_are_lower_triangular():
    """Compiled rollouts and exported policies store nothing above the diagonal."""
    gp, X, Y = noisy()
    L_inv = condition_through(gp, X, Y, inducing_points(gp, X, Y, most=12)).L_inv
    assert (L_inv.triu(1) == 0).all()
    assert (L_inv.diagonal(dim1=-2, dim2=-1) > 0).all()


def test_inducing_points_are_the_least_known_first():
    gp, X, Y = make()
    kept = inducing_points(gp, X, Y, most=6)
    assert len(kept) == 6
    few = inducing_points(gp, X, Y, most=5)
    (last,) = set(kept.tolist()) - set(few.tolist())
    _, variance = gp.condition(X[few], Y[few]).mean_and_variance(X)
    assert (variance / gp.noise_std.detach().square()).amax(1).argmax() == last


def test_inducing_points_end_where_everything_is_known():
    gp, X, Y = make()
    repeated = X[:1].expand(50, 2)
    # one sample leaves a latent variance of nearly s^2, k of them of s^2 / k
    assert len(inducing_points(gp, repeated, Y[:50], most=50, threshold=0.5)) <= 5


def test_one_inducing_point_stays_however_small_the_prior():
    """As beside equations that leave nothing to learn."""
    gp, X, Y = make()
    kept = inducing_points(gp, X, Y, most=12, threshold=1e9)
    assert kept.dtype == torch.int64
    assert len(kept) == 1
    assert torch.isfinite(gp.condition(X[kept], Y[kept]).mean_and_variance(X)[1]).all()
