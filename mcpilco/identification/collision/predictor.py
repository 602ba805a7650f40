"""The posterior of one joint's current, in the form in which one sample costs least.

A Gaussian process phi(x)' w + a(x) f(x), f with an RBF kernel, needs its N training samples only
where the gate a is open; its linear part needs the posterior of the weights w alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import qr

from mcpilco.gp import Posterior
from mcpilco.kernels import RBF, Linear

_SHUT = 1e-6
"""a gate that is closed but for this little is closed [-]"""


@dataclass(frozen=True, eq=False)
class Predictor:
    """Mean and variance of a joint's current [A]."""

    w: Float[np.ndarray, " p"]
    """posterior mean of the weights"""
    D: Float[np.ndarray, " p"]
    """their prior variances"""
    centre: Float[np.ndarray, " D"]
    """about which the training samples lie: distances far from 0 lose digits"""
    lengthscale: Float[np.ndarray, " D"]
    Z: Float[np.ndarray, "M D"]
    """training samples at which the gate is open, about the centre, in lengthscales"""
    prior: float
    """variance of f [A^2]"""
    beta: Float[np.ndarray, " M"]
    """f(z) = k(z, Z) beta"""
    R: Float[np.ndarray, "r p_plus_M"]
    """what the data say lessens the variance by |R [phi; a k(Z, z)]|^2"""
    noise_std: float
    """of the current's measurement [A]"""

    @classmethod
    def of(
        cls,
        posterior: Posterior,
        linear: Linear,
        rbf: RBF | None,
        phi: Float[np.ndarray, "N p"],
        z: Float[np.ndarray, "N D"],
        a: Float[np.ndarray, " N"],
    ) -> Predictor:
        """The predictor of a posterior with one output and the kernel phi' w + a f.

        Args:
            posterior: conditioned on N samples.
            linear: kernel of phi' w, as fitted.
            rbf: kernel of f, as fitted; None where there is no f.
            phi: features of the N samples.
            z: what f sees of them.
            a: the gate at them.
        """
        # K = Phi D Phi' + A Kf A + s^2 I = L L',  alpha = K^-1 y
        # var = phi' D phi + a^2 prior - |L^-1 (Phi D phi + a A k)|^2,  L^-1 [Phi D, A] = Q R
        L_inv, alpha = posterior.L_inv[0].numpy(), posterior.alpha[0].numpy()
        D = linear.weights[0].detach().numpy()
        seen = np.flatnonzero(a > _SHUT) if rbf is not None else np.empty(0, dtype=int)
        scale = np.ones(z.shape[1]) if rbf is None else rbf.lengthscale[0].detach().numpy()
        centre = z[seen].mean(axis=0) if len(seen) else np.zeros(z.shape[1])
        return cls(
            w=D * (alpha @ phi),
            D=D,
            centre=centre,
            lengthscale=scale,
            Z=(z[seen] - centre) / scale,
            prior=0.0 if rbf is None else float(rbf.variance[0]),
            beta=a[seen] * alpha[seen],
            R=qr(np.hstack([(L_inv @ phi) * D, L_inv[:, seen] * a[seen]]), mode="r")[0][
                : len(D) + len(seen)
            ],
            noise_std=float(posterior.noise_std[0]),
        )

    def mean(
        self,
        phi: Float[np.ndarray, "N p"],
        z: Float[np.ndarray, "N D"],
        a: Float[np.ndarray, " N"],
    ) -> Float[np.ndarray, " N"]:
        """The current expected [A].

        Args:
            phi: features.
            z: what f sees.
            a: the gate.
        """
        found = phi @ self.w
        if len(rows := self._open(a)):
            found[rows] += a[rows] * (self._k(z[rows]) @ self.beta)
        return found

    def variance(
        self,
        phi: Float[np.ndarray, "N p"],
        z: Float[np.ndarray, "N D"],
        a: Float[np.ndarray, " N"],
    ) -> Float[np.ndarray, " N"]:
        """Its variance, without the noise of the measurement [A^2]; arguments as of `mean`."""
        p = len(self.D)
        found = phi**2 @ self.D - np.square(phi @ self.R[:, :p].T).sum(axis=1)
        if len(rows := self._open(a)):
            gate = a[rows]
            told = np.hstack([phi[rows], gate[:, None] * self._k(z[rows])]) @ self.R.T
            found[rows] = phi[rows] ** 2 @ self.D + gate**2 * self.prior - (told**2).sum(axis=1)
        return np.maximum(found, 0.0)

    def _open(self, a: Float[np.ndarray, " N"]) -> Int[np.ndarray, " n"]:
        """Rows at which the gate is open."""
        return np.flatnonzero(a) if len(self.beta) else np.empty(0, dtype=int)

    def _k(self, z: Float[np.ndarray, "n D"]) -> Float[np.ndarray, "n M"]:
        """The covariance of f with itself at the training samples [A^2]."""
        z = (z - self.centre) / self.lengthscale
        square = (z * z).sum(axis=1)[:, None] + (self.Z * self.Z).sum(axis=1) - 2.0 * z @ self.Z.T
        return self.prior * np.exp(-0.5 * np.maximum(square, 0.0))
