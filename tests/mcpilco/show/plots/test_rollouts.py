from __future__ import annotations

import builtins

import numpy as np
import pytest

from mcpilco.policies.costs import costs_along
from mcpilco.show.plots.rollouts import plot_costs, plot_input, plot_states
from mcpilco.typing import InputError

plt = pytest.importorskip("matplotlib.pyplot")


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


def test_inputs_are_held_through_their_step(rollout, prediction, task) -> None:
    ax = plot_input(rollout, prediction, task, 0)
    system = line(ax, "system")
    assert system.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(system.get_ydata(), rollout.inputs[:, 0])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "force [N]")


def test_costs_are_drawn_at_the_end_of_their_step(rollout, prediction, task) -> None:
    costs = costs_along(task.cost, rollout.states[1:], rollout.inputs)
    ax = plot_costs(costs, prediction, rollout.dt)
    np.testing.assert_allclose(line(ax, "system").get_xdata(), rollout.times[1:])
    np.testing.assert_array_equal(line(ax, "system").get_ydata(), costs)
    np.testing.assert_array_equal(line(ax, "mean").get_ydata(), prediction.costs.mean(axis=1))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "cost [-]")


def test_costs_that_are_not_known_are_left_out(prediction) -> None:
    labels = [drawn.get_label() for drawn in plot_costs(None, prediction, 0.1).lines]
    assert "mean" in labels
    assert "system" not in labels


def test_missing_matplotlib_names_the_extra(rollout, task, monkeypatch) -> None:
    real = builtins.__import__

    def without_matplotlib(name, *args, **kwargs):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_matplotlib)
    with pytest.raises(InputError, match=r"mcpilco\[report\]"):
        plot_costs(rollout.rewards, None, rollout.dt)
