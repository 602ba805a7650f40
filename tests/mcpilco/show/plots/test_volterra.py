from __future__ import annotations

import numpy as np
import pytest

from mcpilco.show.plots.identification import plot_lags, plot_prediction, plot_response


def test_the_largest_magnitude_is_black_and_zero_is_white() -> None:
    (image,) = plot_lags(np.array([[0.0, -4.0], [2.0, 1.0]]), "h").get_images()
    assert image.get_array().tolist() == [[0.0, 1.0], [0.5, 0.25]]
    assert image.get_clim() == (0.0, 1.0)
    (image,) = plot_lags(np.zeros((2, 2))).get_images()
    assert not np.any(image.get_array())


def test_lags_are_seconds_where_the_sampling_time_is_known() -> None:
    ax = plot_response(np.arange(3.0), dt=0.5)
    assert ax.get_lines()[0].get_xdata().tolist() == [0.0, 0.5, 1.0]
    assert ax.get_xlabel() == "lag [s]"
    assert plot_response(np.arange(3.0)).get_xlabel() == "lag [samples]"


def test_the_band_is_the_interval_of_the_prediction() -> None:
    mean = np.array([np.nan, 1.0, 2.0])
    ax = plot_prediction(np.zeros(3), mean, np.ones(3), "flow [l/s]")
    heights = ax.collections[0].get_paths()[0].vertices[:, 1]
    assert (heights.min(), heights.max()) == pytest.approx((1.0 - 1.96, 2.0 + 1.96))
    assert ax.get_ylabel() == "flow [l/s]"
