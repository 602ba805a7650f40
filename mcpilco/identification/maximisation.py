"""The M-step of `mcpilco.identification.bayesian`: weights, their precision, and the noise."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.identification.latent import Latent, Weights
from mcpilco.identification.moments import Moments

FLOOR = 1e-12
"""of a variance, relative to that of what it is a part of"""


def maximise(
    moments: Moments,
    latent: Latent,
    weights: Weights,
    alpha: Float[np.ndarray, " D"],
    a0: float | None,
    b0: float,
) -> tuple[Weights, Float[np.ndarray, " D"], Float[np.ndarray, " D"] | None]:
    """The weights' posterior, then their mean precision and its rate, then the noise: appendix A.

    Sums over samples in the print are means times N here. `Differs:` from the print's psi_y, whose
    `2 1 y <z>` is 2 y 1^T <z>.

    Args:
        moments: of the data.
        latent: of z and t, with the weights.
        weights: of before.
        alpha: mean precision of before; 0 without priors.
        a0: shape of the prior of alpha; None without priors, where the rate is None too.
        b0: its rate.
    """
    N = moments.N
    xx, yy = np.diag(moments.xx) / N, moments.yy / N
    var_z = 1.0 / (N * latent.tt / weights.psi_z + alpha)
    var_x = 1.0 / (N * latent.tt / weights.psi_x + alpha)
    w_z = var_z * N * latent.zt / weights.psi_z
    w_x = var_x * N * latent.xt / weights.psi_x
    rate = None
    if a0 is None:
        var_z, var_x = np.zeros_like(var_z), np.zeros_like(var_x)
    else:
        rate = b0 + 0.5 * (w_z**2 + var_z + w_x**2 + var_x)
        alpha = (a0 + 1.0) / rate
    psi_y = yy - 2.0 * latent.yz + latent.total
    psi_z = latent.zz - 2.0 * w_z * latent.zt + (w_z**2 + var_z) * latent.tt
    psi_x = xx - 2.0 * w_x * latent.xt + (w_x**2 + var_x) * latent.tt
    found = Weights(
        w_z=w_z,
        w_x=w_x,
        var_z=var_z,
        var_x=var_x,
        psi_z=np.maximum(psi_z, FLOOR * yy),
        psi_x=np.maximum(psi_x, np.maximum(FLOOR * xx, 1e-300)),
        psi_y=max(psi_y, FLOOR * yy),
    )
    return found, alpha, rate
