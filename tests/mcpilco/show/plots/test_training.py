from __future__ import annotations

import numpy as np
import pytest

from mcpilco.show.plots.training import (
    Curve,
    PolicyMap,
    plot_coverage,
    plot_curves,
    plot_errors,
    plot_learning,
    plot_policy,
    plot_search,
    plot_seeds,
    plot_times,
)
from mcpilco.typing import InputError


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


LEVELS = np.array([0.5, 0.9])


def test_coverage_of_a_right_model_lies_within_the_band_of_chance() -> None:
    ax = plot_coverage(LEVELS, {"x": LEVELS}, 100)
    corners = ax.collections[0].get_paths()[0].vertices
    at_half = corners[np.isclose(corners[:, 0], 0.5), 1]
    np.testing.assert_allclose([at_half.min(), at_half.max()], [0.402, 0.598])  # 0.5 -+ 1.96 * 0.05
    assert not plot_coverage(LEVELS, {"x": LEVELS}, None).collections


def test_coverage_draws_a_line_for_each_output() -> None:
    ax = plot_coverage(LEVELS, {"x": LEVELS - 0.1, "y": LEVELS}, None)
    assert [line.get_label() for line in ax.lines[1:]] == ["x", "y"]
    np.testing.assert_array_equal(ax.lines[1].get_ydata(), [0.4, 0.8])


def test_errors_are_drawn_over_time_with_the_unit_of_their_state() -> None:
    ax = plot_errors({1: np.array([0.0, 0.5]), 3: np.array([0.0, 0.1, 0.2])}, 0.1, "angle", "rad")
    assert [line.get_label() for line in ax.lines] == ["trial 1", "trial 3"]
    np.testing.assert_allclose(ax.lines[1].get_xdata(), [0.0, 0.1, 0.2])
    assert ax.get_ylabel() == "error of angle [rad]"


def test_policy_has_colours_for_its_bounds_and_the_way_across() -> None:
    found = PolicyMap(
        x=np.linspace(-1, 1, 5),
        y=np.linspace(-2, 2, 4),
        values=np.zeros((4, 5)),
        path=np.array([[0.0, 0.0], [0.5, 1.0]]),
        low=-10.0,
        high=10.0,
        labels=("angle [rad]", "velocity [rad/s]", "torque [N m]"),
    )
    ax = plot_policy(found)
    assert ax.collections[0].get_clim() == (-10.0, 10.0)
    np.testing.assert_array_equal(ax.lines[0].get_xydata(), found.path)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("angle [rad]", "velocity [rad/s]")


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
