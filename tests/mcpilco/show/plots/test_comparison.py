from __future__ import annotations

import numpy as np
import pytest

from mcpilco.show.plots.comparison import Curve, plot_curves, plot_seeds

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    plt.close("all")


def make_curve(name, amounts):
    values = np.arange(len(amounts), dtype=float)
    return Curve(name, np.array(amounts), values, values - 1.0, values + 2.0)


def test_curves_have_a_line_and_a_band_each():
    ax = plot_curves({0: make_curve("a", [3.0, 6.0]), 2: make_curve("b", [3.0])}, "time up [s]")
    assert [line.get_label() for line in ax.lines] == ["a", "b"]
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), [[3.0, 0.0], [6.0, 1.0]])
    band = ax.collections[0].get_paths()[0].get_extents()
    assert (band.y0, band.y1) == (-1.0, 3.0)
    assert (ax.get_ylabel(), ax.get_xscale()) == ("time up [s]", "linear")


def test_a_run_has_the_colour_of_its_place():
    alone = plot_curves({2: make_curve("b", [3.0, 6.0])}, "p [%]")
    beside = plot_curves({k: make_curve("x", [3.0, 6.0]) for k in range(3)}, "p [%]")
    assert alone.lines[0].get_color() == beside.lines[2].get_color()
    assert len({line.get_color() for line in beside.lines}) == 3


def test_seconds_and_hours_stand_on_a_logarithmic_axis():
    ax = plot_curves({0: make_curve("a", [12.0, 60.0, 3600.0])}, "p [%]")
    assert ax.get_xscale() == "log"
    ax.figure.canvas.draw()
    assert "300" in [label.get_text() for label in ax.get_xticklabels()]


def test_each_seed_is_a_point_in_the_line_of_its_run():
    ax = plot_seeds({0: ("a", [1.0, 2.0, 9.0]), 3: ("b", [4.0])}, "time up [s]")
    points = [line for line in ax.lines if line.get_marker() == "."]
    np.testing.assert_array_equal(points[0].get_xdata(), [1.0, 2.0, 9.0])
    np.testing.assert_array_equal(np.round(points[1].get_ydata()), [1.0])
    assert [label.get_text() for label in ax.get_yticklabels()] == ["a", "b"]
