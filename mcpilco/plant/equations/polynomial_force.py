"""Generalised forces that are polynomials of a robot's motion, for numbers of any kind."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import reduce
from operator import mul
from typing import Any, Literal

from mcpilco.plant.equations.number import Real, cos, sin


class PolynomialForces:
    """r(q, q', q'') = R(q) q'' + s(q, q'): the functions of the kernel GIP, with weights.

    Args:
        kinds: of the J joints, `hinge` or `slide` each.
        terms: joint and monomial of each weight; a monomial is the sorted entries that it
            multiplies of z, see `mcpilco.dynamics.features.JointPolynomials`.
        most: largest acceleration of each joint under these forces [m/s^2 or rad/s^2]: where they
            are extrapolated, polynomials have no bounds.

    Reference: thesis eq. (3.8).
    """

    def __init__(
        self,
        kinds: Sequence[Literal["hinge", "slide"]],
        terms: Sequence[tuple[int, tuple[int, ...]]],
        most: Sequence[float],
    ) -> None:
        self.hinges = [j for j, kind in enumerate(kinds) if kind == "hinge"]
        self.slides = [j for j, kind in enumerate(kinds) if kind == "slide"]
        self.terms = tuple(terms)
        self.most = tuple(most)

    @property
    def count(self) -> int:
        """How many weights there are."""
        return len(self.terms)

    def __call__(
        self, q: Sequence[Real], v: Sequence[Real], weights: Sequence[Real]
    ) -> tuple[list[list[Any]], list[Any]]:
        """R [kg, kg m or kg m^2] and s [N or N m].

        Args:
            q: joint positions [m or rad].
            v: joint velocities [m/s or rad/s].
            weights: one for each term.
        """
        J = len(q)
        places = [*(cos(q[j]) for j in self.hinges), *(sin(q[j]) for j in self.hinges)]
        places += [q[j] for j in self.slides]
        products = [v[i] * v[j] for i in range(J) for j in range(i, J)]
        first = len(places)
        # what a joint's force has of 1, each product of velocities and each acceleration
        shares: dict[tuple[int, int], Any] = defaultdict(float)
        for (joint, monomial), weight in zip(self.terms, weights, strict=True):
            at = [places[d] for d in monomial if d < first]
            moved = max(monomial, default=-1) - first  # -1 and below: it is of the position alone
            share = weight * reduce(mul, at) if at else weight
            shares[joint, max(moved, -1)] = share + shares[joint, max(moved, -1)]
        R: list[list[Any]] = [[0.0] * J for _ in range(J)]
        s: list[Any] = [0.0] * J
        for (joint, moved), share in shares.items():
            if moved >= len(products):
                R[joint][moved - len(products)] = share
            else:
                s[joint] = s[joint] + (share * products[moved] if moved >= 0 else share)
        return R, s
