from __future__ import annotations

import numpy as np
import pytest

from mcpilco.show.plots import plot_learning, plot_search, plot_times
from mcpilco.typing import InputError

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    plt.close("all")


def test_learning_fills_the_marks_of_successes_only(results) -> None:
    ax = plot_learning(results)
    marks = ax.collections[-1]
    faces = marks.get_facecolors()
    assert (faces[0, :3].min(), faces[1, :3].max()) == (1.0, 0.0)  # white, black
    np.testing.assert_array_equal(marks.get_offsets(), [[3.0, 20.0], [6.0, 9.5]])


def test_learning_needs_a_trial() -> None:
    with pytest.raises(InputError, match="at least one trial"):
        plot_learning([])


def test_search_draws_each_trial_darker_than_the_one_before() -> None:
    ax = plot_search({1: [20.0, 15.0], 2: [9.0, 8.0, 7.5]})
    first, second = ax.lines
    np.testing.assert_array_equal(first.get_xdata(), [1, 2])
    np.testing.assert_array_equal(second.get_ydata(), [9.0, 8.0, 7.5])
    assert sum(second.get_color()[:3]) < sum(first.get_color()[:3])


def test_times_are_bars_as_high_as_they_are_long() -> None:
    ax = plot_times([1, 2], [22.5, 2.7], [19.5, 2.1])
    assert [bar.get_height() for bar in ax.patches] == [22.5, 2.7, 19.5, 2.1]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("trial", "time [s]")
