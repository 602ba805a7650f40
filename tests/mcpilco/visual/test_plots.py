from __future__ import annotations

import builtins

import numpy as np
import pytest
import torch

from mcpilco.typing import InputError
from mcpilco.visual.plots import plot_costs, plot_learning, plot_states

matplotlib = pytest.importorskip("matplotlib")
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402


@pytest.fixture(autouse=True)
def _closed_figures():
    yield
    plt.close("all")


def line(ax, label):
    return next(line for line in ax.lines if line.get_label() == label)


def test_states_are_labelled_with_their_units(rollout, prediction, task) -> None:
    axes = plot_states(rollout, prediction, task)
    assert [ax.get_ylabel() for ax in axes] == [
        "cart_position [m]",
        "cart_velocity [m/s]",
        "pole_angle [rad]",
        "pole_velocity [rad/s]",
    ]
    assert {ax.get_xlabel() for ax in axes} == {"time [s]"}


def test_states_show_the_system_in_black_and_the_median_in_blue(rollout, prediction, task) -> None:
    for i, ax in enumerate(plot_states(rollout, prediction, task)):
        system, median = line(ax, "system"), line(ax, "median")
        assert (system.get_color(), median.get_color()) == ("black", "tab:blue")
        np.testing.assert_array_equal(system.get_ydata(), rollout.states[:, i])
        np.testing.assert_array_equal(
            median.get_ydata(), np.median(prediction.states[..., i], axis=1)
        )


def test_band_holds_nine_tenths_of_the_particles(rollout, prediction, task) -> None:
    ax = plot_states(rollout, prediction, task)[0]
    low_high = ax.collections[0].get_paths()[0].vertices
    at = prediction.states[20, :, 0]
    here = low_high[np.isclose(low_high[:, 0], rollout.times[20]), 1]
    inside = (at >= here.min()) & (at <= here.max())
    assert inside.mean() == pytest.approx(0.9, abs=0.03)


def test_states_go_into_given_axes(rollout, task) -> None:
    _, axes = plt.subplots(2, 2)
    assert plot_states(rollout, None, task, axes) == list(axes.flat)


def test_states_refuse_too_few_axes(rollout, task) -> None:
    with pytest.raises(InputError, match="one axis for each"):
        plot_states(rollout, None, task, [plt.subplots()[1]])


def test_costs_are_drawn_at_the_end_of_their_step(rollout, prediction, task) -> None:
    ax = plot_costs(rollout, prediction, task)
    np.testing.assert_allclose(line(ax, "system").get_xdata(), rollout.times[1:])
    costs = task.cost(torch.from_numpy(rollout.states[1:]), torch.from_numpy(rollout.inputs))
    np.testing.assert_array_equal(line(ax, "system").get_ydata(), costs)
    np.testing.assert_array_equal(line(ax, "mean").get_ydata(), prediction.costs.mean(axis=1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "cost [-]")


def test_learning_fills_the_marks_of_successes_only(results) -> None:
    ax = plot_learning(results)
    marks = ax.collections[-1]
    faces = marks.get_facecolors()
    assert (faces[0, :3].min(), faces[1, :3].max()) == (1.0, 0.0)  # white, black
    np.testing.assert_array_equal(marks.get_offsets(), [[3.0, 20.0], [6.0, 9.5]])


def test_learning_needs_a_trial() -> None:
    with pytest.raises(InputError, match="at least one trial"):
        plot_learning([])


def test_missing_matplotlib_names_the_extra(rollout, task, monkeypatch) -> None:
    real = builtins.__import__

    def without_matplotlib(name, *args, **kwargs):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_matplotlib)
    with pytest.raises(InputError, match=r"mcpilco\[report\]"):
        plot_costs(rollout, None, task)
