"""A state by all measurements so far: what a Kalman filter would say, where there is one."""

from __future__ import annotations

import numpy as np
import torch

from mcpilco.dynamics import Delay
from mcpilco.sensing.state_predictor import StatePredictor
from mcpilco.sensing.tracking import StateTracker, Track
from tests.mcpilco.oscillators import known_dynamics, moved

DT, FREQUENCY = 0.1, 3.0
NOISE = np.array([0.05, 0.02])
PUSHED = 0.03
"""spread of what pushes the velocity in each step, unknown to all [m/s]"""


def tracker(delay: Delay, frequency: float = FREQUENCY) -> StateTracker:
    dynamics = known_dynamics(delay, DT, frequency, variance=PUSHED**2)
    return StateTracker(StatePredictor(delay, dynamics), torch.from_numpy(NOISE))


def recorded(steps: int, frequency: float, seed: int = 0):
    """States, measurements, and commands that act at once; the velocity is pushed at random."""
    rng = np.random.default_rng(seed)
    states, commands = [np.array([0.4, 0.0])], rng.uniform(-2, 2, steps)
    for u in commands:
        following = moved(states[-1], u, DT, frequency)
        states.append(following + PUSHED * rng.normal() * np.array([DT / 2, 1.0]))
    measured = np.array(states) + NOISE * rng.normal(size=(steps + 1, 2))
    return np.array(states), measured, commands


def along(found: StateTracker, measured: np.ndarray, commands: np.ndarray) -> list[Track]:
    """The tracks of an episode, or of a batch of them; commands act at once."""
    y, begun = torch.from_numpy(measured), torch.zeros(measured.shape[1:-1], dtype=torch.bool)
    tracks = [found.begin(y[0])]
    for t in range(len(commands)):
        acted = torch.from_numpy(np.asarray(commands[t]))[..., None, None]
        tracks.append(found.follow(tracks[-1], acted, y[t + 1], begun))
    return tracks


def test_of_a_linear_motion_the_tracker_is_the_kalman_filter():
    _, measured, commands = recorded(30, frequency=0.0)
    tracks = along(tracker(Delay(), frequency=0.0), measured, commands)
    A, B = np.array([[1.0, DT], [0.0, 1.0]]), np.array([DT**2 / 2, DT])
    Q = PUSHED**2 * np.outer([DT / 2, 1.0], [DT / 2, 1.0])
    mean, P = measured[0], np.diag(NOISE**2)
    for t, u in enumerate(commands):
        mean, P = A @ mean + B * u, A @ P @ A.T + Q
        # information form, unlike the tracker's: the precisions of both add up
        precision = np.linalg.inv(P) + np.diag(NOISE**-2)
        told = np.linalg.solve(P, mean) + measured[t + 1] / NOISE**2
        mean, P = np.linalg.solve(precision, told), np.linalg.inv(precision)
        np.testing.assert_allclose(tracks[t + 1].states.numpy(), mean, rtol=1e-6, atol=1e-8)
        np.testing.assert_allclose(tracks[t + 1].covariance.numpy(), P, rtol=1e-5, atol=1e-9)


def test_errors_are_smaller_than_those_of_measurements_and_as_large_as_it_says():
    states, measured, commands = recorded(600, FREQUENCY)
    tracks = along(tracker(Delay()), measured, commands)
    errors = np.array([track.states.numpy() for track in tracks]) - states
    assert (errors[10:] ** 2).mean(0)[0] < 0.4 * NOISE[0] ** 2
    covariance = np.array([track.covariance.numpy() for track in tracks])
    squares = np.einsum("ti,tij,tj->t", errors, np.linalg.inv(covariance), errors)
    # of two states the mean is 2, with a standard deviation of 2 / sqrt(600) were they independent
    assert 1.2 < squares[10:].mean() < 2.6


def test_a_late_command_moves_the_state_when_it_acts():
    """With the delay told, the estimates are those of commands that came that much earlier."""
    _, measured, commands = recorded(20, FREQUENCY)
    prompt = along(tracker(Delay()), measured, commands)
    found = tracker(Delay(2))
    y, begun = torch.from_numpy(measured), torch.tensor(False)
    track = found.begin(y[0])
    given = np.concatenate([commands, [0.0, 0.0]])
    for t in range(20):
        newest_first = torch.from_numpy(given[t : t + 3][::-1].copy())[:, None]
        track = found.follow(track, newest_first, y[t + 1], begun)
    torch.testing.assert_close(track.states, prompt[-1].states)


def test_one_of_a_batch_is_tracked_as_if_alone():
    runs = [recorded(6, FREQUENCY, seed) for seed in range(3)]
    measured = np.stack([run[1] for run in runs], 1)
    commands = np.stack([run[2] for run in runs], 1)
    together = along(tracker(Delay()), measured, commands)[-1]
    for i in range(3):
        alone = along(tracker(Delay()), measured[:, i], commands[:, i])[-1]
        torch.testing.assert_close(together.states[i], alone.states)
        torch.testing.assert_close(together.covariance[i], alone.covariance)


def test_an_episode_that_begins_forgets_what_was():
    _, measured, commands = recorded(4, FREQUENCY)
    found = tracker(Delay())
    track = along(found, measured, commands)[-1]
    now = torch.tensor([0.3, -0.2]).double()
    begun = found.follow(track, torch.tensor([[1.0]]).double(), now, torch.tensor(True))
    torch.testing.assert_close(begun.states, now)
    torch.testing.assert_close(begun.covariance, torch.diag(torch.from_numpy(NOISE**2)))
    assert not begun.steps.told.any()


def test_a_measurement_counts_where_the_model_has_no_finite_answer():
    found = tracker(Delay())
    track = found.begin(torch.tensor([0.3, torch.nan]).double())
    now = torch.tensor([0.1, 0.2]).double()
    track = found.follow(track, torch.tensor([[1.0]]).double(), now, torch.tensor(False))
    torch.testing.assert_close(track.states, now)


def test_without_a_model_states_are_what_is_measured():
    found = StateTracker(StatePredictor(Delay(1), None), torch.from_numpy(NOISE))
    now = torch.tensor([0.3, -0.2]).double()
    assert found.begin(now) is None
    assert torch.equal(found.ahead(None, now, torch.zeros(1, 1).double()), now)
