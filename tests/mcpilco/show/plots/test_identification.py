from __future__ import annotations

import numpy as np

from mcpilco.show.plots.identification import plot_torque


def test_torques_are_drawn_measured_and_predicted_with_a_band():
    measured, predicted = np.array([1.0, 2.0, 3.0]), np.array([1.1, 2.1, 2.9])
    ax = plot_torque(measured, predicted, "elbow", "N m", std=np.full(3, 0.5))
    first, second = ax.lines
    np.testing.assert_array_equal(first.get_ydata(), measured)
    np.testing.assert_array_equal(second.get_ydata(), predicted)
    (band,) = ax.collections
    assert band.get_paths()[0].get_extents().ymax == 2.9 + 1.0
    assert ax.get_ylabel() == "elbow [N m]"
