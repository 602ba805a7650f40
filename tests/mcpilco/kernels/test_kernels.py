"""Laws that hold for every kernel. A new kernel joins by one line in `KERNELS`."""

from __future__ import annotations

import pytest
import torch

from mcpilco.kernels import (
    IPK,
    MPK,
    PK,
    RBF,
    SEDMPK,
    ActiveDims,
    Kernel,
    Kinematic,
    Linear,
    NestedKinematic,
    NoCanonicalFormError,
    Positive,
    Scaled,
    VolterraMPK,
)
from mcpilco.kernels.mechanical import GIP
from mcpilco.typing import InputError
from tests.reference.terms import matrix

WIDTH = 3


class Matern12(Kernel):
    """A user's kernel, k = variance exp(-|x - x'| / lengthscale): the formula and nothing else."""

    variance, lengthscale = Positive(), Positive()

    def __init__(self, width, batch=()):
        super().__init__(width, batch)
        self.variance, self.lengthscale = self.spread(1.0), self.spread(1.0, width)

    def forward(self, X1, X2):
        scale = self.lengthscale[..., None, :]
        apart = ((X1 / scale)[..., :, None, :] - (X2 / scale)[..., None, :, :]).square().sum(-1)
        return self.variance[..., None, None] * torch.exp(-(apart + 1e-18).sqrt())


KERNELS = {
    "a user's": lambda batch: Matern12(WIDTH, batch),
    "RBF": lambda batch: RBF(WIDTH, batch),
    "Linear": lambda batch: Linear(WIDTH, batch),
    "Linear without bias": lambda batch: Linear(WIDTH, batch, bias=False),
    "MPK(1)": lambda batch: MPK(WIDTH, 1, batch),
    "MPK(3)": lambda batch: MPK(WIDTH, 3, batch),
    "Kinematic": lambda batch: Kinematic(("slide", "hinge"), batch),
    "NestedKinematic": lambda batch: NestedKinematic(("hinge", "slide"), batch),
    "Sum": lambda batch: RBF(WIDTH, batch) + MPK(WIDTH, 2, batch),
    "Product": lambda batch: RBF(WIDTH, batch) * Linear(WIDTH, batch),
    "Scaled": lambda batch: Scaled(RBF(WIDTH, batch), 3.0),
    "GIP": lambda batch: GIP(("slide",), batch),
    "ActiveDims": lambda batch: ActiveDims(MPK(2, 2, batch), (2, 0), WIDTH),
    "PK": lambda batch: PK(WIDTH, 3, batch),
    "IPK": lambda batch: IPK(WIDTH, 3, batch),
    "VolterraMPK": lambda batch: VolterraMPK(WIDTH, 3, batch),
    "SEDMPK": lambda batch: SEDMPK(WIDTH, 3, batch),
    "SEDMPK, hierarchical": lambda batch: SEDMPK(WIDTH, 3, batch, hierarchical=True),
    "SEDMPK, channels": lambda batch: SEDMPK(WIDTH, 2, batch, channels=WIDTH),
    "SEDMPK beside an RBF": lambda batch: (
        RBF(WIDTH, batch) + ActiveDims(SEDMPK(2, 2, batch), (2, 1), WIDTH)
    ),
    "SEDMPK by an RBF": lambda batch: Scaled(
        RBF(WIDTH, batch) * ActiveDims(SEDMPK(2, 2, batch), (2, 0), WIDTH), 2.0
    ),
}


def shake(kernel: Kernel, seed: int = 0) -> Kernel:
    """The kernel with random hyperparameters, different for each entry of its batch."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for log in kernel.parameters():
            log += 0.5 * torch.randn(log.shape, generator=generator, dtype=log.dtype)
    return kernel


def points(*shape: int, seed: int = 1) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


@pytest.fixture(params=KERNELS)
def make(request):
    return KERNELS[request.param]


def test_kernel_is_symmetric(make):
    kernel, X1, X2 = shake(make((2,))), points(5, WIDTH), points(4, WIDTH, seed=2)
    torch.testing.assert_close(kernel(X1, X2), kernel(X2, X1).mT, rtol=1e-12, atol=1e-12)


def test_kernel_is_positive_semidefinite(make):
    X = points(30, WIDTH)
    eigenvalues = torch.linalg.eigvalsh(shake(make((2,)))(X, X))
    assert (eigenvalues > -1e-12 * eigenvalues.amax()).all()


def test_diag_is_the_diagonal(make):
    kernel, X = shake(make((2,))), points(4, 1, 6, WIDTH)
    diagonal = kernel(X, X).diagonal(dim1=-2, dim2=-1)
    assert diagonal.shape == (4, 2, 6)
    torch.testing.assert_close(kernel.diag(X), diagonal, rtol=1e-12, atol=1e-12)


def terms_of(kernel: Kernel) -> list:
    """Those of a kernel with a canonical form; none of a SEDMPK or a user's, which have none."""
    try:
        return kernel.terms()
    except NoCanonicalFormError:
        assert any(isinstance(part, SEDMPK | Matern12) for part in kernel.modules())
        return []


def test_terms_are_the_kernel(make):
    kernel, X1, X2 = shake(make((2,))), points(5, WIDTH), points(4, WIDTH, seed=2)
    if not (terms := terms_of(kernel)):
        pytest.skip("no canonical form")
    total = sum(matrix(term, X1, X2) for term in terms)
    torch.testing.assert_close(total, kernel(X1, X2), rtol=1e-12, atol=1e-12)


def test_canonical_terms_are_the_kernel_too(make):
    kernel, X1, X2 = shake(make((2,))), points(5, WIDTH), points(4, WIDTH, seed=2)
    try:
        form = kernel.canonical()
    except NoCanonicalFormError:
        pytest.skip("no canonical form")
    total = sum(matrix(term, *map(form.regressors, (X1, X2))) for term in form.terms)
    torch.testing.assert_close(total, kernel(X1, X2), rtol=1e-12, atol=1e-12)
    assert form.W.shape[1] == 0 or not terms_of(kernel)


class Everything(torch.nn.Module):
    """All that a kernel computes from data and hyperparameters."""

    def __init__(self, kernel: Kernel) -> None:
        super().__init__()
        self.kernel = kernel

    def forward(self, X1, X2):
        total = sum((matrix(t, X1, X2) for t in terms_of(self.kernel)), torch.zeros(()))
        return self.kernel(X1, X2), self.kernel.diag(X1), total


@pytest.mark.one_in(2)
def test_gradients_are_right(make):
    module = Everything(shake(make((2,))))
    names, logs = zip(*module.named_parameters(), strict=True)

    def function(X1, X2, *logs):
        state = dict(zip(names, logs, strict=True))
        return torch.func.functional_call(module, state, (X1, X2))

    inputs = points(4, WIDTH), points(3, WIDTH, seed=2), *logs
    inputs = [tensor.detach().clone().requires_grad_() for tensor in inputs]
    assert torch.autograd.gradcheck(function, inputs)


def test_batch_equals_a_loop(make):
    batched, X1, X2 = shake(make((3,))), points(5, WIDTH), points(4, WIDTH, seed=2)
    K, diagonal = batched(X1, X2), batched.diag(X1)
    assert K.shape == (3, 5, 4)
    for e in range(3):
        single = make(())
        with torch.no_grad():
            for own, all_ in zip(single.parameters(), batched.parameters(), strict=True):
                own.copy_(all_[e])
        torch.testing.assert_close(single(X1, X2), K[e])
        torch.testing.assert_close(single.diag(X1), diagonal[e])


def test_leading_axes_of_the_data_broadcast(make):
    kernel, X1, X2 = shake(make((2,))), points(5, WIDTH), points(7, 1, 4, WIDTH, seed=2)
    K = kernel(X1, X2)
    assert K.shape == (7, 2, 5, 4)
    torch.testing.assert_close(K[3], kernel(X1, X2[3, 0]))


def test_start_gives_the_prior_the_mean_square_of_the_targets(make):
    kernel = make((2,))
    X = points(50, WIDTH) * torch.tensor([1.0, 20.0, 0.05]).double()
    Y = points(50, 2, seed=2) * torch.tensor([0.3, 7.0]).double()
    kernel.start_from(X, Y)
    torch.testing.assert_close(kernel.diag(X).mean(-1), Y.square().mean(0))


def test_start_survives_constant_and_zero_columns(make):
    kernel, X = make((2,)), points(20, WIDTH)
    X[:, 0], X[:, 2] = 0.0, 1e3
    kernel.start_from(X, torch.zeros(20, 2).double())
    assert all(log.isfinite().all() for log in kernel.parameters())
    assert kernel(X, X).isfinite().all()


def test_hyperparameters_load_where_they_were_saved(make):
    kernel, other, X = shake(make((2,))), make((2,)), points(5, WIDTH)
    other.load_state_dict(kernel.state_dict())
    torch.testing.assert_close(other(X, X), kernel(X, X))


def test_width_below_one_is_refused():
    with pytest.raises(InputError, match="at least 1 regressor, got 0"):
        RBF(0)
