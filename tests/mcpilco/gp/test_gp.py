from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from mcpilco.gp.evidence import JITTERS, cholesky
from mcpilco.gp.gp import GP, RECENT, Samples
from mcpilco.kernels import MPK, RBF, Kernel
from mcpilco.typing import InputError, NotPositiveDefiniteError

WIDTH, OUTPUTS, SAMPLES = 3, 2, 25
NAMES = ("cart_velocity", "pole_velocity")

KERNELS = {
    "RBF": lambda: RBF(WIDTH, (OUTPUTS,)),
    "RBF + MPK": lambda: RBF(WIDTH, (OUTPUTS,)) + MPK(WIDTH, 2, (OUTPUTS,)),
    "RBF * MPK": lambda: RBF(WIDTH, (OUTPUTS,)) * MPK(WIDTH, 1, (OUTPUTS,)),
}


def normal(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def data(samples: int = SAMPLES, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Two smooth functions of three regressors, with a little noise."""
    X = normal(samples, WIDTH, seed=seed)
    Y = torch.stack([torch.sin(X[:, 0]) + 0.5 * X[:, 1], 3 * torch.cos(X[:, 2]) * X[:, 0]], 1)
    return X, Y + 0.05 * normal(samples, OUTPUTS, seed=seed + 1)


def make_gp(kernel: Kernel | None = None, **keywords) -> GP:
    """A GP with hyperparameters of different sizes for each output and regressor."""
    if kernel is None:
        kernel = RBF(WIDTH, (OUTPUTS,))
        kernel.lengthscale = torch.tensor([[1.0, 1.5, 2.0], [0.7, 3.0, 1.1]])
        kernel.variance = torch.tensor([2.0, 5.0])
    return GP(kernel, **{"noise_std": [0.2, 0.3], "names": NAMES, **keywords})


# --- against independent implementations --------------------------------------------------------


def test_evidence_and_posterior_equal_scikit_learn():
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    (X, Y), Xq, gp = data(), normal(40, WIDTH, seed=5), make_gp()
    mean, variance = gp.condition(X, Y).mean_and_variance(Xq)
    nlml = gp.nlml(X, Y)
    for e in range(OUTPUTS):
        scales = gp.kernel.lengthscale[e].tolist()
        oracle = gaussian_process.GaussianProcessRegressor(
            gp.kernel.variance[e].item() * gaussian_process.kernels.RBF(scales),
            alpha=gp.noise_std[e].item() ** 2,
            optimizer=None,
        ).fit(X.numpy(), Y[:, e].numpy())
        oracle_mean, oracle_std = oracle.predict(Xq.numpy(), return_std=True)
        np.testing.assert_allclose(mean[:, e].detach(), oracle_mean, atol=1e-8)
        np.testing.assert_allclose(variance[:, e].detach(), oracle_std**2, atol=1e-8)
        assert nlml[e].item() == pytest.approx(-oracle.log_marginal_likelihood_value_, abs=1e-8)


@pytest.mark.filterwarnings("ignore")
def test_evidence_and_posterior_equal_gpytorch():
    gpytorch = pytest.importorskip("gpytorch")
    (X, Y), Xq, gp = data(), normal(40, WIDTH, seed=5), make_gp()
    batch = torch.Size([OUTPUTS])

    class Oracle(gpytorch.models.ExactGP):
        def __init__(self, likelihood):
            super().__init__(X.expand(OUTPUTS, -1, -1), Y.mT, likelihood)
            self.mean_module = gpytorch.means.ZeroMean(batch_shape=batch)
            base = gpytorch.kernels.RBFKernel(ard_num_dims=WIDTH, batch_shape=batch)
            self.covar_module = gpytorch.kernels.ScaleKernel(base, batch_shape=batch)

        def forward(self, x):
            prior = self.mean_module(x), self.covar_module(x)
            return gpytorch.distributions.MultivariateNormal(*prior)

    likelihood = gpytorch.likelihoods.GaussianLikelihood(batch_shape=batch)
    oracle = Oracle(likelihood).double()
    oracle.covar_module.base_kernel.lengthscale = gp.kernel.lengthscale.detach()[:, None, :]
    oracle.covar_module.outputscale = gp.kernel.variance.detach()
    likelihood.noise = gp.noise_std.detach().square()[:, None]
    evidence = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, oracle)
    oracle.train()
    torch.testing.assert_close(
        gp.nlml(X, Y), -SAMPLES * evidence(oracle(*oracle.train_inputs), Y.mT), rtol=0, atol=1e-8
    )
    oracle.eval()
    latent = oracle(Xq.expand(OUTPUTS, -1, -1))
    mean, variance = gp.condition(X, Y).mean_and_variance(Xq)
    torch.testing.assert_close(mean.mT, latent.mean, rtol=0, atol=1e-8)
    torch.testing.assert_close(variance.mT, latent.variance, rtol=0, atol=1e-8)


def test_one_sample_has_the_closed_form():
    gp = GP(RBF(1, (1,), variance=4.0), noise_std=1.0)
    x, y = torch.zeros(1, 1).double(), torch.full((1, 1), 2.0).double()
    mean, variance = gp.condition(x, y).mean_and_variance(x)
    assert mean.item() == pytest.approx(4.0 / 5.0 * 2.0)
    assert variance.item() == pytest.approx(4.0 - 16.0 / 5.0)
    nlml = 0.5 * (4.0 / 5.0 + math.log(5.0) + math.log(2 * math.pi))
    assert gp.nlml(x, y).item() == pytest.approx(nlml)


# --- the marginal likelihood --------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_gradient_of_the_evidence_is_right(name: str):
    gp, (X, Y) = make_gp(KERNELS[name]()), data(8)
    names, logs = zip(*gp.named_parameters(), strict=True)

    class Evidence(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.gp = gp

        def forward(self):
            return self.gp.nlml(X, Y)

    def function(*logs):
        state = {f"gp.{name}": log for name, log in zip(names, logs, strict=True)}
        return torch.func.functional_call(Evidence(), state, ())

    inputs = [log.detach().clone().requires_grad_() for log in logs]
    assert torch.autograd.gradcheck(function, inputs)


def test_batch_of_outputs_equals_a_loop():
    (X, Y), gp = data(), make_gp()
    nlml, posterior = gp.nlml(X, Y), gp.condition(X, Y)
    for e in range(OUTPUTS):
        kernel = RBF(
            WIDTH, (1,), lengthscale=gp.kernel.lengthscale[e], variance=gp.kernel.variance[e]
        )
        single = GP(kernel, noise_std=gp.noise_std[e].item())
        torch.testing.assert_close(single.nlml(X, Y[:, [e]])[0], nlml[e])
        for one, all_ in zip(
            single.condition(X, Y[:, [e]]).mean_and_variance(X),
            posterior.mean_and_variance(X),
            strict=True,
        ):
            torch.testing.assert_close(one[:, 0], all_[:, e])


# --- the posterior ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_posterior_variance_never_exceeds_prior_and_stays_positive(name: str):
    gp, (X, Y) = make_gp(KERNELS[name]()).fit(*data()), data()
    Xq = torch.cat([X, 5 * normal(200, WIDTH, seed=9)])
    _, variance = gp.condition(X, Y).mean_and_variance(Xq)
    assert (variance > 0).all()
    assert (variance.mT <= gp.kernel.diag(Xq) * (1 + 1e-9)).all()


def test_posterior_far_away_is_the_prior():
    (X, Y), gp = data(), make_gp()
    mean, variance = gp.condition(X, Y).mean_and_variance(X[:1] + 1e3)
    torch.testing.assert_close(mean, torch.zeros(1, OUTPUTS).double())
    torch.testing.assert_close(variance[0], gp.kernel.variance)


def test_posterior_is_differentiable_in_the_queries_only():
    (X, Y), gp = data(8), make_gp(KERNELS["RBF + MPK"]())
    posterior = gp.condition(X, Y)
    Xq = normal(4, 2, WIDTH, seed=3).requires_grad_()
    assert torch.autograd.gradcheck(posterior.mean_and_variance, (Xq,))
    assert not any(log.requires_grad for log in posterior.kernel.parameters())


def test_queries_take_leading_axes():
    (X, Y), gp = data(), make_gp()
    Xq = normal(4, 5, 6, WIDTH, seed=3)
    mean, variance = gp.condition(X, Y).mean_and_variance(Xq)
    assert mean.shape == variance.shape == (4, 5, 6, OUTPUTS)
    one_mean, one_variance = gp.condition(X, Y).mean_and_variance(Xq[2, 3])
    torch.testing.assert_close(mean[2, 3], one_mean)
    torch.testing.assert_close(variance[2, 3], one_variance)


def test_posterior_caches_the_factorisation():
    (X, Y), gp = data(), make_gp()
    posterior, A = gp.condition(X, Y), gp.covariance(X).detach()
    torch.testing.assert_close(posterior.L @ posterior.L.mT, A)
    torch.testing.assert_close(
        posterior.L_inv @ posterior.L, torch.eye(SAMPLES).double().expand_as(A)
    )
    torch.testing.assert_close((A @ posterior.alpha[..., None]).squeeze(-1), Y.mT)


def test_posterior_does_not_follow_later_fits():
    (X, Y), gp = data(), make_gp()
    posterior = gp.condition(X, Y)
    before = posterior.mean_and_variance(X)[0]
    gp.fit(X, 10 * Y)
    torch.testing.assert_close(posterior.mean_and_variance(X)[0], before)


def test_variance_at_repeated_samples_is_positive_without_a_noise_floor():
    X = torch.zeros(300, 1).double()
    gp = GP(RBF(1, (1,)), noise_std=1e-7, noise_floor=0.0)
    _, variance = gp.condition(X, X).mean_and_variance(X[:5])
    assert (variance > 0).all()


# --- fitting ------------------------------------------------------------------------------------


def test_fit_recovers_hyperparameters():
    """Targets drawn from a GP with known hyperparameters, which 300 samples determine."""
    truth = GP(RBF(2, (2,)), noise_std=[0.1, 0.3])
    truth.kernel.lengthscale = torch.tensor([[0.5, 1.0], [2.0, 0.4]])
    truth.kernel.variance = torch.tensor([1.0, 4.0])
    X = 4 * torch.rand(300, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    with torch.no_grad():
        L = torch.linalg.cholesky(truth.covariance(X))
        Y = (L @ normal(2, 300, 1)).squeeze(-1).mT
    gp = GP(RBF(2, (2,))).fit(X, Y)
    torch.testing.assert_close(gp.noise_std, truth.noise_std, rtol=0.15, atol=0)
    torch.testing.assert_close(gp.kernel.lengthscale, truth.kernel.lengthscale, rtol=0.25, atol=0)
    assert (gp.nlml(X, Y) <= truth.nlml(X, Y)).all()


@pytest.mark.parametrize("name", KERNELS)
def test_fit_ends_where_the_gradient_vanishes(name: str):
    gp, (X, Y) = make_gp(KERNELS[name]()), data()
    gp.fit(X, Y, tolerance=1e-12, max_iterations=2000)
    assert gp.report.converged
    (slope,) = torch.autograd.grad(gp.nlml(X, Y).sum(), gp.log_noise_excess)
    at_noise_floor = gp.noise_std < gp.noise_floor * 1.01
    assert (slope.abs() < 0.05)[~at_noise_floor].all()


def test_fit_lowers_the_evidence_and_reports_it():
    gp, (X, Y) = make_gp(), data()
    gp.kernel.start_from(X, Y)
    before = gp.nlml(X, Y)
    assert gp.fit(X, Y) is gp
    after = gp.nlml(X, Y)
    assert (after < before - 1.0).all()
    torch.testing.assert_close(torch.tensor(gp.report.nlml, dtype=torch.float64), after)
    assert gp.report.converged
    assert 0 < gp.report.iterations <= gp.report.evaluations


def test_fit_cut_short_says_that_it_did_not_converge():
    for optimiser in ("lbfgs", "adam"):
        report = make_gp().fit(*data(), optimiser=optimiser, max_iterations=3).report
        assert not report.converged
        assert report.iterations == 3


def test_a_prior_holds_the_hyperparameters_at_their_start_as_its_width_says():
    X, Y = data(samples=12)
    start = make_gp()
    start._start_from(X, Y)
    centre = start.get_logs()
    moved = [
        np.abs(make_gp().fit(X, Y, prior_std=std).get_logs() - centre).max()
        for std in (0.01, 1.0, 1000.0)
    ]
    assert moved[0] < 0.01
    assert 10 * moved[0] < moved[1] < moved[2]


def test_fit_with_a_prior_ends_where_the_gradient_of_the_posterior_density_vanishes():
    X, Y = data(samples=12)
    gp = make_gp()
    gp._start_from(X, Y)
    centre = torch.from_numpy(gp.get_logs())
    gp.fit(X, Y, prior_std=0.7, tolerance=1e-12, max_iterations=2000)
    slopes = torch.autograd.grad(gp.nlml(X, Y).sum(), list(gp.parameters()))
    slope = torch.cat([g.reshape(OUTPUTS, -1) for g in slopes], 1)
    pull = (torch.from_numpy(gp.get_logs()) - centre) / 0.7**2
    assert pull.abs().max() > 0.1
    assert (slope + pull).abs().max() < 0.02


@pytest.mark.slow
def test_adam_and_lbfgs_find_the_same_optimum():
    X, Y = data(12)
    lbfgs, adam = (
        GP(RBF(1, (1,)), noise_floor=0.1).fit(
            X[:, :1], Y[:, :1], optimiser=optimiser, max_iterations=1500
        )
        for optimiser in ("lbfgs", "adam")
    )
    assert adam.report.converged
    np.testing.assert_allclose(adam.report.nlml, lbfgs.report.nlml, atol=0.02)


def test_restarts_never_end_worse():
    X, Y = data()
    once = make_gp(KERNELS["RBF + MPK"]()).fit(X, Y).report.nlml
    more = make_gp(KERNELS["RBF + MPK"]()).fit(X, Y, restarts=2).report.nlml
    assert (np.array(more) <= np.array(once)).all()


def test_equal_seeds_fit_equally():
    X, Y = data()
    one, two = (make_gp().fit(X, Y, restarts=2, seed=3).to_arrays() for _ in range(2))
    for name in one:
        np.testing.assert_array_equal(one[name], two[name])


def test_fit_forgets_the_present_hyperparameters_unless_warm():
    (X, Y), cold, other = data(), make_gp().fit(*data()), make_gp()
    other.kernel.lengthscale = 17.0
    other.fit(X, Y)
    np.testing.assert_array_equal(other.report.nlml, cold.report.nlml)
    again = make_gp()
    again.load_arrays(cold.to_arrays())
    again.fit(X, Y, warm=True)
    assert again.report.iterations < 0.5 * cold.report.iterations


def test_noise_floor_is_respected():
    X, _ = data()
    gp = make_gp(noise_floor=[0.05, 0.2], noise_std=None).fit(X, X[:, :2])  # exact, noise-free
    assert (gp.noise_std >= gp.noise_floor).all()
    torch.testing.assert_close(
        gp.noise_std.detach(), torch.tensor([0.05, 0.2]).double(), rtol=0.1, atol=0
    )


def test_targets_of_any_unit_fit_alike():
    """Micrometres or kilometres: only the density of the targets changes."""
    X, Y = data()
    densities = [
        np.array(GP(RBF(WIDTH, (2,)), noise_floor=0.001 * unit).fit(X, unit * Y).report.nlml)
        - SAMPLES * math.log(unit)
        for unit in (1e-6, 1.0, 1e3)
    ]
    np.testing.assert_allclose(densities[0], densities[1], atol=0.1)
    np.testing.assert_allclose(densities[2], densities[1], atol=0.1)


# --- ill data -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", KERNELS)
def test_constant_columns_repeated_rows_and_still_targets_fit(name: str):
    X, Y = data(10)
    X[:, 0], X[:, 1], Y[:, 0] = 0.0, 3.0, 0.0
    X, Y = X.repeat(6, 1), Y.repeat(6, 1)
    gp = make_gp(KERNELS[name]()).fit(X, Y)
    mean, variance = gp.condition(X, Y).mean_and_variance(X)
    assert mean.isfinite().all()
    assert (variance > 0).all()


@pytest.mark.parametrize("samples", [1, 2])
def test_hardly_any_data_fit(samples: int):
    X, Y = data(samples)
    mean, _ = make_gp().fit(X, Y).condition(X, Y).mean_and_variance(X)
    assert mean.isfinite().all()


def test_jitter_ladder_takes_the_least_that_helps_and_only_where_needed():
    good = torch.eye(3).double() * 2.0
    bad = torch.ones(3, 3).double() - 2e-9 * torch.diag(torch.tensor([0.0, 0.0, 1.0])).double()
    L = cholesky(torch.stack([good, bad]), NAMES)
    torch.testing.assert_close(L[0] @ L[0].mT, good, rtol=0, atol=1e-15)
    added = (L[1] @ L[1].mT - bad).diagonal()
    torch.testing.assert_close(added, torch.full((3,), 1e-8).double(), rtol=1e-4, atol=1e-15)


def test_error_names_the_output_the_jitters_and_the_condition():
    good, bad = torch.eye(3).double(), torch.diag(torch.tensor([1.0, 1.0, -0.01])).double()
    with pytest.raises(NotPositiveDefiniteError) as error:
        cholesky(torch.stack([good, bad]), NAMES)
    message = str(error.value)
    assert "pole_velocity" in message
    assert "cart_velocity" not in message
    assert str(JITTERS) in message
    assert "condition number about 1e+02, smallest eigenvalue -1.0e-02" in message
    assert "raise noise_floor" in message


def test_not_a_number_in_a_matrix_is_named():
    with pytest.raises(NotPositiveDefiniteError, match="cart_velocity .not finite"):
        cholesky(torch.full((2, 3, 3), torch.nan).double(), NAMES)


class Fragile(RBF):
    """An RBF kernel that loses its factor at short lengthscales, where the optimum lies."""

    def forward(self, X1, X2):
        sign = torch.where(self.lengthscale[:, 0] < 1.2, -1.0, 1.0)
        return sign[:, None, None] * super().forward(X1, X2)


def test_fit_turns_back_from_matrices_without_a_factor():
    X, Y = data()
    gp = make_gp(Fragile(WIDTH, (OUTPUTS,))).fit(X, Y)
    assert (gp.kernel.lengthscale[:, 0] >= 1.2).all()
    assert np.isfinite(gp.report.nlml).all()


def test_fit_that_cannot_even_start_says_so():
    X, Y = data()
    with pytest.raises(NotPositiveDefiniteError, match="cart_velocity"):
        make_gp(Fragile(WIDTH, (OUTPUTS,))).fit(0.01 * X, Y)


# --- wrong arguments ----------------------------------------------------------------------------


def test_data_that_do_not_fit_are_refused(unchecked_shapes):
    X, Y = data()
    gp = make_gp()
    for wrong in ((X[:, :2], Y), (X, Y[:, :1]), (X[:5], Y), (X[:0], Y[:0]), (X[0], Y[0])):
        with pytest.raises(InputError, match="GP needs regressors"):
            gp.fit(*wrong)
        with pytest.raises(InputError, match="GP needs regressors"):
            gp.condition(*wrong)


def test_data_that_are_not_finite_are_refused():
    X, Y = data()
    Y[3, 1] = torch.nan
    with pytest.raises(InputError, match="targets must be finite, row 3"):
        make_gp().fit(X, Y)


def test_arguments_that_do_not_fit_are_refused(unchecked_shapes):
    with pytest.raises(InputError, match="one batch axis"):
        GP(RBF(2))
    with pytest.raises(InputError, match="name each of the 2 outputs"):
        make_gp(names=("one",))
    with pytest.raises(InputError, match="above the noise_floor"):
        make_gp(noise_std=0.01)
    with pytest.raises(InputError, match="not be negative"):
        make_gp(noise_floor=-1.0)
    with pytest.raises(InputError, match="one of .'adam', 'lbfgs'., got 'sgd'"):
        make_gp().fit(*data(), optimiser="sgd")


# --- saving -------------------------------------------------------------------------------------


def test_arrays_bring_the_gp_back():
    (X, Y), gp = data(), make_gp(KERNELS["RBF + MPK"]()).fit(*data())
    arrays = gp.to_arrays()
    assert all(isinstance(array, np.ndarray) for array in arrays.values())
    other = make_gp(KERNELS["RBF + MPK"](), noise_floor=0.002)
    other.load_arrays(arrays)
    torch.testing.assert_close(other.nlml(X, Y), gp.nlml(X, Y), rtol=0, atol=0)
    other.fit(X, 2 * Y)
    np.testing.assert_array_equal(arrays["noise_floor"], gp.to_arrays()["noise_floor"])


def test_arrays_that_do_not_fit_are_refused():
    gp = make_gp()
    arrays = gp.to_arrays()
    with pytest.raises(InputError, match="missing .'log_noise_excess'.*unknown .'extra'"):
        gp.load_arrays(
            {**{k: v for k, v in arrays.items() if "excess" not in k}, "extra": np.ones(2)}
        )
    with pytest.raises(InputError, match="kernel.log_variance must be finite with shape .2,., got"):
        gp.load_arrays({**arrays, "kernel.log_variance": np.ones(3)})
    with pytest.raises(InputError, match="kernel.log_variance must be finite"):
        gp.load_arrays({**arrays, "kernel.log_variance": np.full(2, np.nan)})


def after(steps: tuple[int, ...], T: int = 6, seed: int = 5) -> Samples:
    """Further samples of a batch, drawn for each of it."""
    X, Y = normal(*steps, T, WIDTH, seed=seed), normal(*steps, T, OUTPUTS, seed=seed + 1)
    return Samples(X, Y, torch.ones(*steps, T, dtype=torch.bool))


@pytest.mark.parametrize("kernel", KERNELS)
def test_further_samples_count_as_the_others(kernel):
    gp, (X, Y), query = make_gp(KERNELS[kernel]()), data(), normal(2, 3, 4, WIDTH, seed=9)
    gp.fit(X, Y)
    further = after((2, 3))
    found = gp.condition(X, Y).after(further).mean(query)
    for i, j in np.ndindex(2, 3):
        together = gp.condition(torch.cat([X, further.X[i, j]]), torch.cat([Y, further.Y[i, j]]))
        expected, _ = together.mean_and_variance(query[i, j])
        torch.testing.assert_close(found[i, j], expected, rtol=1e-5, atol=1e-5)


def test_what_is_not_told_does_not_count():
    gp, (X, Y), query = make_gp(), data(), normal(2, 4, WIDTH, seed=9)
    posterior, further = gp.condition(X, Y), after((2,))
    some = Samples(further.X, further.Y, further.told.clone())
    some.told[0, 2:], some.told[1] = False, False
    found = posterior.after(some).mean(query)
    first = Samples(further.X[0, :2], further.Y[0, :2], further.told[0, :2])
    torch.testing.assert_close(found[0], posterior.after(first).mean(query[0]))
    torch.testing.assert_close(found[1], posterior.mean_and_variance(query[1])[0])


def test_further_samples_far_beyond_all_others_break_nothing():
    gp, (X, Y), query = make_gp(KERNELS["RBF + MPK"]()), data(), normal(4, WIDTH, seed=9)
    gp.fit(X, Y)
    posterior, further = gp.condition(X, Y), after(())
    for size in 10.0 ** np.arange(2, 12):
        X_far = torch.cat([further.X[:3], size * further.X[3:]])
        far = posterior.after(Samples(X_far, further.Y, further.told))
        assert far.mean(query).isfinite().all()


def test_the_latest_samples_are_kept_and_a_start_forgets_them():
    steps = after((2,), T=1)
    begun = torch.tensor([False, True])
    for k in range(RECENT + 5):
        x = torch.full((2, WIDTH), float(k)).double()
        steps = steps.then(x, x[:, :OUTPUTS], begun if k == RECENT else ~begun & begun)
    assert steps.X.shape == (2, RECENT, WIDTH)
    assert steps.X[:, -1].eq(RECENT + 4).all()
    assert steps.told[0].all()
    assert steps.told[1].sum() == 4


@pytest.mark.parametrize("optimiser", ["lbfgs", "adam"])
def test_a_fit_tells_each_iteration_and_finds_the_same(optimiser: str) -> None:
    X = torch.linspace(0, 3, 12, dtype=torch.float64)[:, None]
    told: list[tuple[int, int]] = []
    silent, loud = GP(RBF(1, (1,))), GP(RBF(1, (1,)))
    loud.on_iteration = lambda step, most: told.append((step, most))
    for gp in (silent, loud):
        gp.fit(X, X.sin(), optimiser=optimiser, max_iterations=9)
    assert told == [(k, 9) for k in range(1, loud.report.iterations + 1)]
    assert np.array_equal(silent.get_logs(), loud.get_logs())


def test_evidence_of_odd_functions_is_that_of_their_covariance():
    rng = np.random.default_rng(3)
    X, Y = torch.from_numpy(rng.normal(size=(6, 2))), torch.from_numpy(rng.normal(size=(6, 1)))
    gp = GP(RBF(2, (1,)), noise_std=0.3)
    K = gp.kernel(X, X) - gp.kernel(X, -X) + 0.3**2 * torch.eye(6)
    normal = torch.distributions.MultivariateNormal(torch.zeros(6).double(), K[0])
    assert gp.odd_nlml(X, -X, Y).item() == pytest.approx(-normal.log_prob(Y[:, 0]).item())


def test_evidence_tells_an_odd_function_from_another():
    X = torch.linspace(-2, 2, 15, dtype=torch.float64)[:, None]
    gp = GP(RBF(1, (1,)), noise_std=0.1)
    for Y, odd in ((X.sin(), True), (X.cos(), False)):
        assert bool(gp.odd_nlml(X, -X, Y) < gp.nlml(X, Y)) == odd
