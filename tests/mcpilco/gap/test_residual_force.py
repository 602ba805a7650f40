from __future__ import annotations

import numpy as np
import pytest

import envs
from mcpilco.gap.data import Windows, cut, usual_scales
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model
from mcpilco.gap.plant_model import PlantModel
from mcpilco.gap.residual_force import force_response, unpredicted_by_forces
from mcpilco.gap.thresholds import FORCE
from mcpilco.plant import Plant
from mcpilco.recordings import Recording
from tests.mcpilco.gap.light import LIGHT, spun
from tests.mcpilco.gap.pendulum import STD, Force, Outside, record

PLANT = envs.PLANTS["mcpilco/Pendulum-v0"]()


def nothing(q: float, v: float) -> float:
    return 0.0


def nominal_fit(force: Force = nothing, outside: Outside = lambda time: 0.0) -> tuple[Fit, Windows]:
    """The pendulum without effects, on recordings in which a force is hidden."""
    rng = np.random.default_rng(1)
    return fitted(PLANT, [record(rng, force, number, outside=outside) for number in range(2)])


def fitted(plant: Plant, measured: list[Recording]) -> tuple[Fit, Windows]:
    """A plant without effects, on recordings."""
    windows = cut(measured, np.array([STD, 1.0]))
    model = PlantModel(plant, (), {}, usual_scales(plant, windows))
    x0 = fit_initial_states(model, windows, np.zeros(0))
    return fit_model(model, windows, np.zeros(0), x0), windows


def predicted(fit: Fit, windows: Windows) -> float:
    """The part of the squared residuals beyond the noise that other windows predict."""
    response = force_response(fit, windows)
    left = unpredicted_by_forces(response) * response.samples
    beyond = np.maximum(response.by_window - response.samples, 0.0)
    return float(response.weights @ (response.by_window - left) / (response.weights @ beyond))


def test_a_force_that_depends_on_the_state_is_predicted_from_window_to_window() -> None:
    def feeding(q: float, v: float) -> float:
        return 0.2 * v / (1.0 + v * v)

    assert predicted(*nominal_fit(feeding)) > 0.6


def test_a_force_that_depends_on_the_place_in_a_turn_is_predicted_over_many_turns() -> None:
    """As a motor's cogging."""
    measured = spun("position_ripple", (0.03, 0.04, 2.0), 40)
    assert np.ptp(measured.states[:, 0]) > 3.0 * FORCE.most_turned_rad
    assert predicted(*fitted(LIGHT, [measured])) > 0.6


@pytest.mark.slow
def test_a_force_that_comes_from_outside_is_not_predicted() -> None:
    phases = np.random.default_rng(2).uniform(0.0, 6.0, 8)

    def wind(time: float) -> float:
        return 0.1 * float(np.sum(np.sin(2.0 * np.pi * np.arange(1, 9) * 0.37 * time + phases)))

    assert predicted(*nominal_fit(outside=wind)) < 0.3


def test_the_response_is_what_a_pushed_pendulum_does() -> None:
    """Beside the same difference quotient with a hand-made constant torque."""
    found, windows = nominal_fit()
    response = force_response(found, windows)
    usual = found.model.scales["pendulum"].force
    hold = 3  # samples, as HOLD_S
    commands = windows.commands[0].copy()
    first = windows.lead + 5 * hold
    size = 1e-3 * usual
    y = []
    for sign in (1.0, -1.0):
        moved = commands.copy()
        moved[first : first + hold, 0] += sign * size
        y.append(PLANT.simulate(found.x0[:1], moved[None, windows.lead :], windows.dt)[0])
    change = (y[0] - y[1])[: windows.y.shape[2], 0] / (2.0 * size / usual) / STD
    seen = windows.measured[0, 0]
    lin_free = response.G[0][: windows.y.shape[2], 5]
    basis = _start_columns(found, windows)
    told = np.where(seen, change, 0.0)
    told = told - basis @ (basis.T @ told)
    np.testing.assert_allclose(lin_free, told, atol=1e-3 * np.abs(told).max())


def _start_columns(found: Fit, windows: Windows) -> np.ndarray:
    """Orthonormal columns of what a start state does to the angles of the first window."""
    plant, columns = found.model.plant, []
    for nudge in (np.array([[1e-4, 0.0]]), np.array([[0.0, 1e-3]])):
        commands = windows.commands[:1, windows.lead :]
        up = plant.simulate(found.x0[:1] + nudge, commands, windows.dt)[0]
        down = plant.simulate(found.x0[:1] - nudge, commands, windows.dt)[0]
        angle = (up - down)[: windows.y.shape[2], 0]
        columns.append(np.where(windows.measured[0, 0], angle, 0.0))
    return np.linalg.qr(np.stack(columns, axis=1))[0]
