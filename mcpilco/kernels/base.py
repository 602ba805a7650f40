"""The base class of covariance functions, and the algebra that makes new kernels of old ones.

A kernel is one `nn.Module` for all E outputs at once: its hyperparameters have a batch shape,
`(E,)` in a GP, and its matrices carry that batch in front, `(E, N, M)`.

A kernel of one's own is a class with its hyperparameters and one method, the formula:

    class Matern12(Kernel):
        variance, lengthscale = Positive(), Positive()

        def __init__(self, width, batch=()):
            super().__init__(width, batch)
            self.variance, self.lengthscale = self.spread(1.0), self.spread(1.0, width)

        def forward(self, X1, X2):
            scale = self.lengthscale[..., None, :]
            return self.variance[..., None, None] * torch.exp(-torch.cdist(X1 / scale, X2 / scale))

    agent = MCPILCO("SumOfGaussians", env, kernel=Matern12)
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, product
from operator import mul
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor, nn

from mcpilco.typing import InputError

Rows = Float[Tensor, "*#b N D"]
"""N regressors; leading axes broadcast with the kernel's batch"""
Columns = Float[Tensor, "*#b M D"]
"""M further ones"""
Matrix = Float[Tensor, "*#b N M"]
"""covariances of the two"""


class NoCanonicalFormError(InputError, NotImplementedError):
    """A kernel that is not a sum of terms v exp(-|x - x'|^2_w / 2) prod_r (c_r + <x, x'>_s_r)."""


class Positive:
    """A positive hyperparameter: read and assigned as itself, learned as its log, `log_<name>`."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name, self._log_name = name, f"log_{name}"

    def __get__(self, module: nn.Module, owner: type | None = None) -> Tensor:
        return self if module is None else getattr(module, self._log_name).exp()

    def __set__(self, module: nn.Module, value: float | Tensor) -> None:
        value = torch.as_tensor(value, dtype=torch.float64).detach()
        if not bool((value > 0).all() and value.isfinite().all()):
            raise InputError(
                f"{type(module).__name__}.{self._name} must be positive and finite, "
                f"got {value.tolist()}."
            )
        parameter = module._parameters.get(self._log_name)
        if parameter is None:  # the first assignment gives the shape
            module.register_parameter(self._log_name, nn.Parameter(value.log()))
        else:
            with torch.no_grad():
                parameter.copy_(value.log())


@dataclass(frozen=True)
class Term:
    """k(x, x') = v exp(-1/2 sum_d w_d (x_d - x'_d)^2) prod_{r=1..R} (c_r + sum_d s_rd x_d x'_d).

    Every kernel with a canonical form is a sum of these: all that a fused rollout must know of it.
    """

    v: Float[Tensor, "*b"]
    """scale"""
    w: Float[Tensor, "*b D"]
    """inverse squared lengthscales; zeros without an exponential factor"""
    c: Float[Tensor, "*b R"]
    """offset of each linear factor; R may be 0"""
    s: Float[Tensor, "*b R D"]
    """weights of each linear factor"""

    def __mul__(self, other: Term) -> Term:
        """The product of two terms is a term."""
        return Term(
            self.v * other.v,
            self.w + other.w,
            torch.cat([self.c, other.c], -1),
            torch.cat([self.s, other.s], -2),
        )

    def scaled(self, variance: Float[Tensor, "*b"]) -> Term:
        """The same term, `variance` times as large."""
        return Term(variance * self.v, self.w, self.c, self.s)

    def scattered(self, dims: Tensor, width: int) -> Term:
        """The same term of regressors of `width`, of which it sees `dims`."""

        def scatter(weights: Tensor) -> Tensor:
            return weights.new_zeros(*weights.shape[:-1], width).index_copy(-1, dims, weights)

        return Term(self.v, scatter(self.w), self.c, scatter(self.s))


@dataclass(frozen=True)
class Canonical:
    """A kernel as a sum of canonical terms, of the regressors and of combinations of them."""

    W: Float[Tensor, "D M"]
    """the combinations are x W; M is 0 where the kernel needs none"""
    terms: list[Term]
    """of [x, x W]"""

    def regressors(self, X: Float[Tensor, "*b N D"]) -> Float[Tensor, "*b N D_plus_M"]:
        """The regressors of the terms: x and its combinations x W."""
        return torch.cat([X, X @ self.W], -1)


class Kernel(nn.Module, ABC):
    """A covariance function of regressors of a given width, one for each entry of a batch.

    A subclass needs `forward` only. It overrides `diag` where the diagonal is cheaper than N
    matrices of one row, `start_from` where the data say more than below, and `terms` where the
    kernel is a sum of canonical terms: compiled rollouts know it then.

    Args:
        width: D, how many regressors it sees.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
    """

    def __init__(self, width: int, batch: Sequence[int] = ()) -> None:
        super().__init__()
        if width < 1:
            raise InputError(
                f"{type(self).__name__} needs a width of at least 1 regressor, got {width}."
            )
        self.width = width
        self.batch = tuple(batch)

    @abstractmethod
    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        """The matrix k(X1, X2); leading axes broadcast with the kernel's batch."""

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        """The diagonal of k(X, X), without the matrix."""
        lead = torch.broadcast_shapes(self.batch, X.shape[:-2])
        rows = X.expand(*lead, *X.shape[-2:]).movedim(-2, 0)[..., None, :]  # (N, *b, 1, D)
        return self(rows, rows)[..., 0, 0].movedim(0, -1)

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Set, in place, hyperparameters from which a fit to these data may start.

        The prior variance, averaged over the data, becomes the mean square of the targets. By
        default a hyperparameter `lengthscale` that is one for each regressor, or one for all,
        becomes their standard deviation times sqrt(D), and `variance` is scaled to the targets;
        hyperparameters of other names stay as they are.
        """
        if (lengthscale := self._hyperparameter("lengthscale")) is not None:
            typical = typical_size(X) * self.width**0.5
            several = lengthscale.shape[len(self.batch) :] == (self.width,)
            self.lengthscale = (typical if several else typical.mean()).expand(lengthscale.shape)
        if (variance := self._hyperparameter("variance")) is not None:
            with torch.no_grad():
                self.variance = variance * mean_square(Y) / self.diag(X).mean(-1)

    def _hyperparameter(self, name: str) -> Tensor | None:
        """The positive hyperparameter of this name; None where the class has none."""
        positive = isinstance(getattr(type(self), name, None), Positive)
        return getattr(self, name) if positive else None

    def terms(self) -> list[Term]:
        """The kernel as a sum of canonical terms, differentiable in its hyperparameters.

        Raises:
            NoCanonicalFormError: the kernel is not such a sum.
        """
        raise NoCanonicalFormError(
            f"{type(self).__name__} has no canonical form; roll out with the plain torch "
            "posterior, or use sums and products of RBF, Linear and MPK."
        )

    def canonical(self) -> Canonical:
        """The kernel as a sum of canonical terms, of combinations of the regressors if need be.

        Raises:
            NoCanonicalFormError: the kernel is not such a sum.
        """
        terms = self.terms()
        return Canonical(torch.zeros(self.width, 0, dtype=torch.float64), terms)

    def spread(self, value: float | Sequence[float] | Tensor, *shape: int) -> Tensor:
        """A hyperparameter of this shape for each entry of the batch."""
        value = torch.as_tensor(value, dtype=torch.float64)
        try:
            return value.expand((*self.batch, *shape))
        except RuntimeError as error:
            raise InputError(
                f"{type(self).__name__} expected a hyperparameter that broadcasts to "
                f"{(*self.batch, *shape)}, got shape {tuple(value.shape)}."
            ) from error

    def __add__(self, other: Kernel) -> Sum:
        return Sum(self, other)

    def __mul__(self, other: Kernel) -> Product:
        return Product(self, other)

    def extra_repr(self) -> str:
        return f"width={self.width}, batch={self.batch}"


class _Composite(Kernel):
    """Kernels of one width and batch, held together."""

    def __init__(self, *parts: Kernel) -> None:
        shapes = {(part.width, part.batch) for part in parts}
        if len(shapes) != 1:
            raise InputError(
                f"{type(self).__name__} needs parts of one width and batch, got (width, batch) "
                f"{sorted(shapes)}; wrap a narrower kernel in ActiveDims."
            )
        super().__init__(parts[0].width, parts[0].batch)
        self.parts: Sequence[Kernel] = nn.ModuleList(parts)  # type: ignore[assignment]

    operation: ClassVar[Callable[[Tensor, Tensor], Tensor]]
    """from two kernels' values to those of both together"""

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        return reduce(type(self).operation, (part(X1, X2) for part in self.parts))

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        return reduce(type(self).operation, (part.diag(X) for part in self.parts))

    @abstractmethod
    def combined(self, parts: Iterable[list[Term]]) -> list[Term]:
        """The terms of this kernel, given those of its parts."""

    def terms(self) -> list[Term]:
        return self.combined(part.terms() for part in self.parts)

    def canonical(self) -> Canonical:
        forms, begin = [part.canonical() for part in self.parts], self.width
        W, scattered = torch.cat([form.W for form in forms], 1), []
        for form in forms:
            end = begin + form.W.shape[1]
            dims = torch.tensor([*range(self.width), *range(begin, end)])
            scattered.append([term.scattered(dims, sum(W.shape)) for term in form.terms])
            begin = end
        return Canonical(W, self.combined(scattered))


class Sum(_Composite):
    """k(x, x') = sum_i k_i(x, x')."""

    operation = torch.add

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        for part in self.parts:
            part.start_from(X, Y / len(self.parts) ** 0.5)

    def combined(self, parts: Iterable[list[Term]]) -> list[Term]:
        return list(chain.from_iterable(parts))


class Product(_Composite):
    """k(x, x') = prod_i k_i(x, x')."""

    operation = torch.mul

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        first, *others = self.parts
        first.start_from(X, Y)
        for part in others:
            part.start_from(X, torch.ones_like(Y))

    def combined(self, parts: Iterable[list[Term]]) -> list[Term]:
        return [reduce(mul, choice) for choice in product(*parts)]


class Scaled(Kernel):
    """k(x, x') = variance * k_1(x, x')."""

    variance = Positive()

    def __init__(self, kernel: Kernel, variance: float | Tensor = 1.0) -> None:
        super().__init__(kernel.width, kernel.batch)
        self.kernel = kernel
        self.variance = self.spread(variance)

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        return self.variance[..., None, None] * self.kernel(X1, X2)

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        return self.variance[..., None] * self.kernel.diag(X)

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        self.kernel.start_from(X, torch.ones_like(Y))
        self.variance = mean_square(Y)

    def terms(self) -> list[Term]:
        return self._scaled(self.kernel.terms())

    def canonical(self) -> Canonical:
        form = self.kernel.canonical()
        return Canonical(form.W, self._scaled(form.terms))

    def _scaled(self, terms: list[Term]) -> list[Term]:
        return [term.scaled(self.variance) for term in terms]


class ActiveDims(Kernel):
    """k(x, x') = k_1(x_dims, x'_dims): a kernel of some of the regressors.

    Args:
        kernel: k_1, as wide as there are `dims`.
        dims: which regressors it sees.
        width: how many regressors there are.
    """

    dims: Tensor

    def __init__(self, kernel: Kernel, dims: Sequence[int], width: int) -> None:
        super().__init__(width, kernel.batch)
        dims = tuple(dims)
        if len(set(dims)) != kernel.width or any(not 0 <= dim < width for dim in dims):
            raise InputError(
                f"ActiveDims needs {kernel.width} different dims, as many as its kernel is wide, "
                f"within 0..{width - 1}, got {dims}."
            )
        self.kernel = kernel
        self.register_buffer("dims", torch.tensor(dims), persistent=False)

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        return self.kernel(X1[..., self.dims], X2[..., self.dims])

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        return self.kernel.diag(X[..., self.dims])

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        self.kernel.start_from(X[:, self.dims], Y)

    def terms(self) -> list[Term]:
        return [term.scattered(self.dims, self.width) for term in self.kernel.terms()]

    def canonical(self) -> Canonical:
        form = self.kernel.canonical()
        W = form.W.new_zeros(self.width, form.W.shape[1]).index_copy(0, self.dims, form.W)
        dims = torch.cat([self.dims, torch.arange(self.width, sum(W.shape))])
        return Canonical(W, [term.scattered(dims, sum(W.shape)) for term in form.terms])


def typical_size(X: Float[Tensor, "N D"]) -> Float[Tensor, " D"]:
    """The standard deviation of each regressor; the size of one that is constant, or else 1."""
    std, size = X.std(0, correction=0), X.abs().amax(0)
    size = torch.where(size > 0, size, torch.ones_like(size))
    return torch.where(std > 1e-9 * size, std, size)


def mean_square(Y: Float[Tensor, " N *b"]) -> Float[Tensor, "*b"]:
    """The mean square of each output; 1 for an output that is zero throughout."""
    power = Y.square().mean(0)
    return torch.where(power > 0, power, torch.ones_like(power))
