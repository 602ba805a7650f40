"""Kernels of robots whose kinds of joints are known: forward kinematics, and inverse dynamics.

`Kinematic` and `NestedKinematic` are polynomials in the cosines and sines of a chain's hinges and
the positions of its slides: their regressors are x = [c_1 .. c_R, z_1 .. z_R, q_1 .. q_P], cosines
and sines of the R hinges, then the positions of the P slides (thesis eq. 2.21). `GIP` is a prior
over the inverse dynamics of any robot with such joints.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from typing import Literal, cast

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.kernels.base import ActiveDims, Kernel, Positive, Product, Term, mean_square
from mcpilco.kernels.polynomial import MPK
from mcpilco.typing import InputError

HINGE, SLIDE = "hinge", "slide"
_SHARE = 0.5
"""what a regressor explains at the start of a fit, beside the constant of its factor [-]"""

Linear = Callable[[Sequence[int]], Tensor]
"""from some regressors to sum_d weights_d x_d x'_d over them, a matrix or its diagonal"""


class _OfChain(Kernel):
    """The joints of a chain, and the hyperparameters that both kernels share.

    Args:
        kinds: `hinge` or `slide` for each joint, from the base to the tip.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.
    """

    weights = Positive()
    """one for each regressor: a_1 .. a_R, s_1 .. s_R, w_1 .. w_P"""

    def __init__(self, kinds: Sequence[str], batch: Sequence[int] = ()) -> None:
        unknown = sorted(set(kinds) - {HINGE, SLIDE})
        if unknown or not kinds:
            raise InputError(
                f"{type(self).__name__} needs joints that are {HINGE} or {SLIDE}, one at "
                f"least, got {', '.join(unknown) or 'none'}."
            )
        self._hinges = list(kinds).count(HINGE)
        super().__init__(self._hinges + len(kinds), batch)
        self.kinds = tuple(kinds)
        self.weights = self.spread(_SHARE, self.width)

    def _dims(self) -> list[list[int]]:
        """The regressors of each joint: cosine and sine, or position."""
        turns, slides = iter(range(self._hinges)), iter(range(2 * self._hinges, self.width))
        return [
            [b := next(turns), self._hinges + b] if kind == HINGE else [next(slides)]
            for kind in self.kinds
        ]

    def forward(
        self, X1: Float[Tensor, "*#b N D"], X2: Float[Tensor, "*#b M D"]
    ) -> Float[Tensor, "*#b N M"]:
        weighted = X1 * self.weights[..., None, :]
        return self._made_of(lambda dims: weighted[..., dims] @ X2[..., dims].mT, (None, None))

    def diag(self, X: Float[Tensor, "*#b N D"]) -> Float[Tensor, "*#b N"]:
        weighted = X.square() * self.weights[..., None, :]
        return self._made_of(lambda dims: weighted[..., dims].sum(-1), (None,))

    @abstractmethod
    def _made_of(self, linear: Linear, axes: tuple[None, ...]) -> Tensor:
        """The kernel, a matrix or its diagonal; `axes` are what hyperparameters lack of its own."""

    def _term(self, v: Tensor, factors: Sequence[Sequence[int]], bare: bool = False) -> Term:
        """v times the factors of these regressors; a bare last factor has no constant."""
        member = self.weights.new_zeros(len(factors), self.width)
        c = self.weights.new_ones(*self.batch, len(factors))
        for row, dims in enumerate(factors):
            member[row, list(dims)] = 1.0
        if bare:
            c[..., -1] = 0.0
        return Term(v, torch.zeros_like(self.weights), c, member * self.weights[..., None, :])


class Kinematic(_OfChain):
    """k(x, x') = v prod_b (1 + a_b c_b c'_b + s_b z_b z'_b) (1 + sum_p w_p q_p q'_p).

    The prior is over all polynomials of degree one in each pair (c_b, z_b) and one in all q
    together, 3^R (1 + P) monomials: the entries of the pose of any link of any such chain are
    among them, whatever the order of its joints.

    Reference: thesis eqs. (2.22) and (2.23), proposition 2.5.1.
    Differs: the thesis gives each factor a scale of its own, of which all but one cannot be told
    apart; here the factors begin with 1 and v is the scale of all.
    """

    variance = Positive()

    def __init__(self, kinds: Sequence[str], batch: Sequence[int] = ()) -> None:
        super().__init__(kinds, batch)
        self.variance = self.spread(1.0)

    def _factors(self) -> list[list[int]]:
        """The regressors of each factor: those of all slides make one."""
        dims = self._dims()
        slides = [d[0] for d in dims if len(d) == 1]
        return [d for d in dims if len(d) == 2] + ([slides] if slides else [])

    def _made_of(self, linear: Linear, axes: tuple[None, ...]) -> Tensor:
        k = self.variance[(..., *axes)]
        for dims in self._factors():
            k = k * (1.0 + linear(dims))
        return k

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every regressor explains the same share of its factor."""
        self.weights = self.spread(_SHARE / mean_square(X), self.width)
        self.variance = self.spread(1.0)
        self.variance = mean_square(Y) / self.diag(X).mean(-1)

    def terms(self) -> list[Term]:
        return [self._term(self.variance, self._factors())]


class NestedKinematic(_OfChain):
    """k = v_0 + f_1 (v_1 + f_2 (v_2 + ... f_R v_R)), f_b = 1 + a_b c_b c'_b + s_b z_b z'_b.

    So a pose is made: t_0 + R_1 (t_1 + R_2 (t_2 + ...)), link by link. A slide adds
    w_p q_p q'_p in the bracket where it stands. The functions are among those of `Kinematic`, but
    a monomial of a far joint comes with those of the joints before it: where the order of the
    joints is known, this prior needs fewer data.

    Differs: the thesis has no such kernel; it uses the types of the joints, not their order.
    """

    offsets = Positive()
    """v_0 .. v_R"""

    def __init__(self, kinds: Sequence[str], batch: Sequence[int] = ()) -> None:
        super().__init__(kinds, batch)
        self.offsets = self.spread(1.0, self._hinges + 1)

    def _made_of(self, linear: Linear, axes: tuple[None, ...]) -> Tensor:
        """From the innermost bracket outwards."""
        offsets, left = self.offsets[(..., *axes, slice(None))], self._hinges
        k = offsets[..., left]
        for dims in reversed(self._dims()):
            if len(dims) == 1:
                k = k + linear(dims)
            else:
                left -= 1
                k = offsets[..., left] + k * (1.0 + linear(dims))
        return k

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Every regressor explains the same share of its factor, every offset the same."""
        self.weights = self.spread(_SHARE / mean_square(X), self.width)
        self.offsets = self.spread(1.0, self._hinges + 1)
        share = mean_square(Y) / self.diag(X).mean(-1)
        self.offsets = self.offsets * share[..., None]
        slides = list(range(2 * self._hinges, self.width))
        scale = torch.ones_like(self.weights)
        scale[..., slides] = share[..., None]
        self.weights = self.weights * scale

    def terms(self) -> list[Term]:
        return list(self._summands())

    def _summands(self) -> Iterator[Term]:
        before: list[list[int]] = []
        yield self._term(self.offsets[..., 0], before)
        for dims in self._dims():
            if len(dims) == 1:
                yield self._term(torch.ones_like(self.offsets[..., 0]), [*before, dims], bare=True)
            else:
                before = [*before, dims]
                yield self._term(self.offsets[..., len(before)], before)


Kind = Literal["hinge", "slide"]

HARMONICS = 0.1
"""start of a position's weight, in parts of its factor's offset [-]"""
_SMALLEST = 1e-12
"""least mean square that a regressor is scaled by, in its squared unit"""


class GIP(Product):
    """k(z, z') = prod_hinges mpk2([c, s]) prod_slides mpk2([q]) mpk1([q'q', q'']): eq. (3.11).

    The torque of a joint, by Lagrange's equations, is a polynomial in the entries of z: of degree 2
    in cosine and sine of each hinge, and in the position of each slide, and of degree 1 in the
    products of velocities and the accelerations. The kernel's functions are these polynomials, for
    every robot with such joints; nothing but the kinds of the joints is told.

    z is [cos(hinges), sin(hinges), slides, products of velocities, accelerations]: what
    `mcpilco.dynamics.features.JointPolynomials` makes of q, q' and q''.

    Args:
        kinds: of the J joints, `hinge` or `slide` each.
        batch: shape of the hyperparameters, `(E,)` for the E outputs of a GP.

    Reference: thesis eqs. (3.8), (3.10) and (3.11), proposition 3.3.1.
    """

    def __init__(self, kinds: Sequence[Kind], batch: Sequence[int] = ()) -> None:
        kinds = tuple(kinds)
        if not kinds or any(kind not in ("hinge", "slide") for kind in kinds):
            raise InputError(f"GIP needs a kind for each joint, hinge or slide, got {kinds}.")
        J, hinges = len(kinds), kinds.count("hinge")
        angles = [(h, hinges + h) for h in range(hinges)]
        slides = [(2 * hinges + p,) for p in range(J - hinges)]
        first = J + hinges  # of the motion
        width = first + J * (J + 1) // 2 + J
        factors: list[Kernel] = [
            ActiveDims(MPK(len(dims), 2, batch), dims, width) for dims in (*angles, *slides)
        ]
        motion = range(first, width)
        super().__init__(*factors, ActiveDims(MPK(len(motion), 1, batch), motion, width))
        self.kinds = kinds

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """Forces that depend a little on each position, and equally on all that moves.

        Every factor of a position is near 1: where positions outweigh the offsets of many joints,
        the product is all but white noise, and a fit stalls at torques that are noise throughout.
        """
        *positions, motion = cast(Sequence[ActiveDims], self.parts)
        for factor in positions:
            mpk = cast(MPK, factor.kernel)
            size = X[:, factor.dims].square().mean(0).clamp_min(_SMALLEST)
            mpk.offset_steps = mpk.spread(torch.tensor([1e-3, 1.0]), 2)
            mpk.weight_steps = mpk.spread(HARMONICS / size, 2, mpk.width)
        motion.start_from(X, torch.ones_like(Y))
        power = mean_square(Y) / self.diag(X).mean(-1)
        mpk = cast(MPK, motion.kernel)
        mpk.offset_steps = mpk.offset_steps * power[..., None]
        mpk.weight_steps = mpk.weight_steps * power[..., None, None]
