"""The prior of a force on a grid."""

from __future__ import annotations

import numpy as np

from mcpilco.plant import Axis, GridPrior


def test_the_prior_of_a_grid_is_the_product_of_those_over_its_axes() -> None:
    axes = Axis("angle", -1.0, 1.0, 9), Axis("velocity", -4.0, 4.0, 7, slow=0.2)
    prior = GridPrior.of(axes, (0.4, 1.0), least=0.0)
    weights = prior.weights(np.eye(len(prior.kept[0])))
    parts = [
        np.exp(-0.5 * ((axis.places[:, None] - axis.places) / lengthscale) ** 2)
        for axis, lengthscale in zip(axes, (0.4, 1.0), strict=True)
    ]
    np.testing.assert_allclose(weights @ weights.T, np.kron(*parts), atol=1e-9)
    x = [np.array([0.3, -0.2]), np.array([1.0, -2.0])]
    rows = (axes[0].splines(x[0])[:, :, None] * axes[1].splines(x[1])[:, None]).reshape(2, -1)
    np.testing.assert_allclose(prior.features(x), rows @ weights, atol=1e-12)
