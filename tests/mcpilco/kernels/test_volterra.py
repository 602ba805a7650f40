from __future__ import annotations

from itertools import product
from math import comb

import pytest
import torch

from mcpilco.gp import GP
from mcpilco.kernels import IPK, PK, RBF, SEDMPK, ActiveDims, VolterraKernel, VolterraMPK
from mcpilco.kernels.polynomial import MonomialBasis
from mcpilco.typing import InputError
from tests.mcpilco.kernels.test_kernels import points, shake

KERNELS = {
    "PK": lambda width, degree: PK(width, degree, (2,)),
    "IPK": lambda width, degree: IPK(width, degree, (2,)),
    "IPK, offset given": lambda width, degree: IPK(width, degree, (2,), offset=0.7),
    "MPK": lambda width, degree: VolterraMPK(width, degree, (2,)),
    "SED-MPK": lambda width, degree: SEDMPK(width, degree, (2,)),
    "SED-MPK, hierarchical": lambda width, degree: SEDMPK(width, degree, (2,), hierarchical=True),
    "SED-MPK, channels": lambda width, degree: SEDMPK(width, degree, (2,), channels=2),
}
DIAGONAL = ("PK", "IPK", "IPK, offset given", "MPK")


@pytest.fixture(params=KERNELS)
def make(request):
    return KERNELS[request.param]


@pytest.mark.parametrize(("width", "degree"), [(2, 1), (4, 2), (4, 3)])
def test_feature_space_is_the_kernel(make, width: int, degree: int) -> None:
    kernel: VolterraKernel = shake(make(width, degree))
    X1, X2 = points(6, width), points(5, width, seed=2)
    basis = MonomialBasis(width, degree)
    product = basis(X1) @ kernel.weight_covariance(basis) @ basis(X2).mT
    assert basis(X1).shape == (6, MonomialBasis.size(width, degree))
    torch.testing.assert_close(product, kernel(X1, X2), rtol=1e-12, atol=1e-12)


def test_weights_of_monomials_are_a_covariance(make) -> None:
    kernel = shake(make(4, 3))
    eigenvalues = torch.linalg.eigvalsh(kernel.weight_covariance(MonomialBasis(4, 3)))
    assert (eigenvalues > -1e-12 * eigenvalues.amax()).all()


def test_a_basis_has_each_monomial_once() -> None:
    basis = MonomialBasis(6, 3)
    assert basis.counts == [1, 6, 21, 56]
    assert len(set(map(tuple, basis.entries.T.tolist()))) == comb(9, 3)
    x = torch.tensor([[2.0, 3.0]]).double()
    assert MonomialBasis(2, 2)(x).tolist() == [[1.0, 2.0, 3.0, 4.0, 6.0, 9.0]]


def test_mpk_of_equal_factors_is_pk() -> None:
    """Only the last step of each degree: thesis eq. (6.24) with one Sigma is (6.17)."""
    pk, mpk = shake(PK(3, 3)), VolterraMPK(3, 3)
    with torch.no_grad():
        mpk.log_weight_steps.fill_(-60.0)
        mpk.log_weight_steps[[0, 2, 5]] = pk.log_weights
        mpk.log_constant.copy_(pk.log_constant)
    X = points(5, 3)
    torch.testing.assert_close(mpk(X, X), pk(X, X), rtol=1e-12, atol=1e-12)


def test_ipk_is_its_formula() -> None:
    X, kernel = points(5, 3), shake(IPK(3, 3))
    linear = (X * kernel.weights) @ X.mT
    torch.testing.assert_close(kernel(X, X), (kernel.offset + linear) ** 3)
    assert IPK(3, 2, offset=0.7).offset == 0.7
    assert not [name for name, _ in IPK(3, 2, offset=0.7).named_parameters() if "offset" in name]


def test_sed_metric_is_smooth_and_decays() -> None:
    """Thesis eq. (6.35), entry by entry."""
    kernel = SEDMPK(3, 2)
    kernel.decorrelation_steps, kernel.decay_steps = 0.3, 0.2
    kernel.scales = torch.tensor([1.0, 5.0])
    (_, (S,)), (scale, metrics) = kernel.maps()
    for i, j in product(range(3), repeat=2):
        expected = torch.tensor(-0.3 * abs(i - j) - 0.2 * (i + j)).double().exp()
        torch.testing.assert_close(S[i, j], expected)
    assert scale.item() == pytest.approx(5.0)
    assert metrics[0] is metrics[1] is S


def test_sed_hierarchy_sums_steps_backwards() -> None:
    kernel = SEDMPK(2, 2, hierarchical=True)
    kernel.decay_steps = torch.tensor([[1.0], [10.0], [100.0]])
    assert kernel.decay[:, 0].tolist() == pytest.approx([1.0, 110.0, 100.0])


def test_channels_of_sed_do_not_mix_within_a_factor() -> None:
    kernel = shake(SEDMPK(4, 1, channels=2))
    first, second = points(1, 4).clone(), points(1, 4, seed=2).clone()
    first[:, 2:], second[:, :2] = 0.0, 0.0
    torch.testing.assert_close(kernel(first, second)[0, 0], kernel.constant)


@pytest.mark.parametrize("name", DIAGONAL)
def test_penalties_are_weights_shared_among_orders(name: str) -> None:
    """Thesis eq. (6.37): lambda_q over the number of orders of its lags."""
    kernel, basis = shake(KERNELS[name](3, 3)), MonomialBasis(3, 3)
    weights = kernel.weight_covariance(basis).diagonal(dim1=-2, dim2=-1)
    for degree in (1, 2, 3):
        penalties = kernel.penalties(degree)
        for lags in product(range(3), repeat=degree):
            key = [*sorted(lag + 1 for lag in lags), *[0] * (3 - degree)]
            q = basis.entries.T.tolist().index(key)
            orders = len(
                basis.places[degree - 1][basis.places[degree - 1] == q - lower(basis, degree)]
            )
            expected = weights[:, q] / orders
            torch.testing.assert_close(penalties[(slice(None), *lags)], expected)


def lower(basis: MonomialBasis, degree: int) -> int:
    """How many monomials have a smaller degree."""
    return sum(basis.counts[:degree])


def test_penalties_of_sed_fall_with_the_lag() -> None:
    penalties = SEDMPK(5, 2).penalties(2)
    assert penalties.shape == (5, 5)
    torch.testing.assert_close(penalties, penalties.mT)
    assert (penalties.diff(dim=0) < 0).all()


def test_mpk_can_allow_a_lag_in_products_but_not_squared() -> None:
    """What PK cannot: u_1 u_2 without u_1^2 and u_2^2, as in the example of section 6.5.1."""
    kernel = VolterraMPK(2, 2)
    kernel.weight_steps = torch.tensor([[1.0, 1.0], [1.0, 1e-9], [1e-9, 1.0]])
    penalties = kernel.penalties(2)
    assert penalties[0, 1] > 0.4
    assert penalties[0, 0] < 1e-8


@pytest.mark.parametrize("kernel", [PK, IPK, VolterraMPK, SEDMPK])
def test_degree_below_one_is_refused(kernel) -> None:
    with pytest.raises(InputError, match="degree of at least 1, got 0"):
        kernel(2, 0)


def test_channels_of_unequal_length_are_refused() -> None:
    with pytest.raises(InputError, match="2 channels, got a width of 5"):
        SEDMPK(5, 2, channels=2)


def test_sed_of_past_inputs_beside_an_rbf_of_the_state_learns_a_slow_actuator() -> None:
    """As in a dynamics model: the buffer of inputs are regressors beside the state."""

    def data(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
        state, u = points(120, 1, seed=seed), points(129, 1, seed=seed + 1)[:, 0]
        buffer = u.unfold(0, 10, 1).flip(-1)
        decay = 0.7 ** torch.arange(10).double()
        return torch.cat([state, buffer], 1), state.sin() + 0.5 * (buffer @ decay)[:, None]

    (X, Y), (queries, truth) = data(3), data(7)
    state = ActiveDims(RBF(1, (1,)), (0,), 11)
    kernels = {
        "buffer": state + ActiveDims(SEDMPK(10, 2, (1,)), range(1, 11), 11),
        "present input": ActiveDims(RBF(2, (1,)), (0, 1), 11),
    }
    errors = {}
    for name, kernel in kernels.items():
        posterior = GP(kernel, noise_floor=0.01).fit(X, Y, tolerance=1e-4).condition(X, Y)
        mean, _ = posterior.mean_and_variance(queries.requires_grad_())
        errors[name] = (mean - truth).square().mean().sqrt().item()
    assert errors["buffer"] < 0.1 < 0.3 < errors["present input"]
    (gradient,) = torch.autograd.grad(
        GP(kernels["buffer"]).condition(X, Y).mean_and_variance(queries)[0].sum(), queries
    )
    assert (gradient[:, 1:].abs().mean(0) > 0).all()
