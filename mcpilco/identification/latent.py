"""The E-step of `mcpilco.identification.bayesian`: what y and x tell of z and t."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.identification.moments import Moments


@dataclass(frozen=True)
class Weights:
    """Means and variances of w, and variances of the noise, in the units of x and y."""

    w_z: Float[np.ndarray, " D"]
    w_x: Float[np.ndarray, " D"]
    var_z: Float[np.ndarray, " D"]
    """of w_z; 0 in joint factor analysis"""
    var_x: Float[np.ndarray, " D"]
    """of w_x"""
    psi_z: Float[np.ndarray, " D"]
    psi_x: Float[np.ndarray, " D"]
    psi_y: float


@dataclass(frozen=True)
class Latent:
    """Means over samples of posterior moments of z and t."""

    zz: Float[np.ndarray, " D"]
    """of z_m^2"""
    zt: Float[np.ndarray, " D"]
    """of z_m t_m"""
    tt: Float[np.ndarray, " D"]
    """of t_m^2"""
    xt: Float[np.ndarray, " D"]
    """of x_m t_m"""
    yz: float
    """of y 1^T z"""
    total: float
    """of (1^T z)^2"""
    log_det: float
    """log det Sigma, the covariance of (z, t) in each sample"""


def expect(moments: Moments, weights: Weights) -> Latent:
    """The moments of z and t under their posterior, for O(D^2) operations.

    With the precision of (z, t), its blocks and what they act on,

        P_zz = 1 1^T / psi_y + Psi_z^-1    P_zt = -W_z Psi_z^-1    P_tt = K
        h_z = 1 y / psi_y                  h_t = W_x Psi_x^-1 x

    the appendix's Sigma_zz = M - M 1 1^T M / k, k = psi_y + 1^T M 1, is diagonal but for a part of
    rank one, so that with D = W_z Psi_z^-1 K^-1 and g = 1 y / psi_y + D h_t

        <z> = Sigma_zz g = M (g - 1 s / k),  s = 1^T M g        <t> = K^-1 h_t + D <z>

    are linear in y, x and the one number s, whose moments with x are one product with X^T X.

    `Differs:` from the appendix, which prints Sigma_zt = -Sigma_zz W_z Psi_z^-1 K^-1; its sign is
    plus, as the inverse of P has it. And from its <z_i>, which multiplies by Sigma_zt where the
    row form takes Sigma_tz.
    """
    w, N = weights, moments.N
    xx, xy, yy = np.diag(moments.xx) / N, moments.xy / N, moments.yy / N
    K = 1.0 + (w.w_x**2 + w.var_x) / w.psi_x + (w.w_z**2 + w.var_z) / w.psi_z
    M = w.psi_z + w.w_z**2 / (1.0 + (w.w_x**2 + w.var_x) / w.psi_x + w.var_z / w.psi_z)
    k = w.psi_y + M.sum()
    D = w.w_z / (w.psi_z * K)
    c = w.w_x / w.psi_x  # h_t = c x
    e = D * c  # g = y / psi_y + e x
    # s = a_y y + a_x^T x and its moments with y, x, itself
    a_y, a_x = M.sum() / w.psi_y, M * e
    sx = a_y * xy + moments.xx @ a_x / N
    sy = a_y * yy + a_x @ xy
    ss = a_y * sy + a_x @ sx
    gg = yy / w.psi_y**2 + 2.0 * e * xy / w.psi_y + e**2 * xx
    gs = sy / w.psi_y + e * sx
    gx = xy / w.psi_y + e * xx
    zz = M**2 * (gg - 2.0 * gs / k + ss / k**2)  # of the means, so far
    zx = M * (gx - sx / k)
    cov_zz = M - M**2 / k
    tx = c / K * xx + D * zx
    return Latent(
        zz=zz + cov_zz,
        zt=c / K * zx + D * zz + D * cov_zz,
        tt=c / K * tx + D * (c / K * zx + D * zz) + 1.0 / K + D**2 * cov_zz,
        xt=tx,
        yz=float(sy * w.psi_y / k),
        total=float(ss * (w.psi_y / k) ** 2 + w.psi_y * M.sum() / k),
        log_det=float(np.log(M).sum() - np.log(K).sum() - np.log(k / w.psi_y)),
    )
