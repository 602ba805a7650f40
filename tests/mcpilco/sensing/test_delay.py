"""Estimators of late actuators: the state in which a command acts."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mcpilco.agent import Model
from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from mcpilco.dynamics import AngleAugmentation, Delay, GPDynamics, speed_integration
from mcpilco.search import rollout
from mcpilco.search.particles import Sensing
from mcpilco.sensing.delay import DelayModel, StatePredictor, StateTracker, Track
from mcpilco.sensing.estimator import Observer
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics, make_policy
from tests.mcpilco.oscillators import known_dynamics, late, moved, oscillator

# --- in rollouts ----------------------------------------------------------------------------------

STEPS, PARTICLES = 9, 5
SPREAD = torch.tensor([0.05, 0.1, 0.02, 0.2], dtype=torch.float64)


def shown(task: TaskSpec, delay: Delay, noise_std: torch.Tensor = SPREAD, spread: float = 1.0):
    """A rollout, the measurements in it, and what the policy saw."""
    generator = torch.Generator().manual_seed(3)
    start, noise, errors = (
        torch.randn(*shape, generator=generator, dtype=torch.float64)
        for shape in ((PARTICLES, 4), (STEPS, PARTICLES, 2), (STEPS, PARTICLES, 4))
    )
    dynamics, policy, seen = make_dynamics(task), make_policy(task), []

    def watched(states, dropout, step):
        seen.append(states)
        return policy(states, dropout, step)

    sensing = Sensing(Observer(DelayModel(dynamics, delay), noise_std), errors)
    with torch.no_grad():
        particles = rollout(dynamics, watched, 0.3 * start, spread * noise, sensing=sensing)
    measured = particles.states[:-1] + noise_std * errors
    return dynamics, particles, measured, torch.stack(seen)


@pytest.mark.parametrize("whole", [1, 2, 3])
def test_a_policy_acts_on_the_prediction_from_old_measurements(task, whole: int) -> None:
    dynamics, particles, measured, seen = shown(task, Delay(whole))
    predictor = StatePredictor(Delay(whole), dynamics)
    for t in range(whole, STEPS):
        past = particles.inputs[t - whole : t].flip(0).movedim(0, 1)  # newest first
        torch.testing.assert_close(seen[t], predictor(measured[t - whole], past))
        assert (seen[t] - particles.states[t]).abs().min() > 0


def test_before_anything_was_predicted_it_acts_on_the_states(task: TaskSpec) -> None:
    _, particles, _, seen = shown(task, Delay(2))
    torch.testing.assert_close(seen[0], particles.states[0])


@pytest.mark.parametrize("delay", [Delay(1), Delay(2), Delay(0, 0.5), Delay(1, 0.3)])
def test_where_nothing_errs_it_acts_on_the_states(task: TaskSpec, delay: Delay) -> None:
    _, particles, _, seen = shown(task, delay, noise_std=0 * SPREAD, spread=0.0)
    torch.testing.assert_close(seen, particles.states[:-1])


def test_part_of_a_step_counts_as_a_whole_one(task: TaskSpec) -> None:
    assert torch.equal(shown(task, Delay(1, 0.25))[-1], shown(task, Delay(2))[-1])


# --- on the system --------------------------------------------------------------------------------

DT, FREQUENCY = 0.1, 3.0
NOISE = np.array([0.05, 0.02])
PUSHED = 0.03
"""spread of what pushes the velocity in each step, unknown to all [m/s]"""


def tracker(delay: Delay, frequency: float = FREQUENCY) -> StateTracker:
    dynamics = known_dynamics(delay, DT, frequency, variance=PUSHED**2)
    return StateTracker(StatePredictor(delay, dynamics), 1, torch.from_numpy(NOISE))


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
    """The tracks of an episode, or of a batch of them."""
    y = torch.from_numpy(measured)
    _, track = found.observe(y[0], found.begin(y[0]))
    tracks = [track]
    for t in range(len(commands)):
        given = found.after(tracks[-1], torch.from_numpy(np.asarray(commands[t]))[..., None])
        tracks.append(found.observe(y[t + 1], given)[1])
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
    late, y = tracker(Delay(2)), torch.from_numpy(measured)
    _, track = late.observe(y[0], late.begin(y[0]))
    given = np.concatenate([commands, [0.0, 0.0]])
    for t in range(20):  # before an episode commands were 0: they are given a step early twice
        past = torch.from_numpy(given[t : t + 3][::-1].copy())[:, None]  # newest first
        _, track = late.observe(y[t + 1], dataclasses.replace(track, past=past))
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
    runs = [recorded(4, FREQUENCY, seed) for seed in range(2)]
    found = tracker(Delay())
    together = np.stack([run[1] for run in runs], 1), np.stack([run[2] for run in runs], 1)
    track = found.after(along(found, *together)[-1], torch.ones(2, 1).double())
    now = torch.tensor([[0.3, -0.2], [0.1, 0.4]]).double()
    _, begun = found.observe(now, track, torch.tensor([True, False]))
    torch.testing.assert_close(begun.states[0], now[0])
    assert not torch.isclose(begun.states[1], now[1]).any()
    torch.testing.assert_close(begun.covariance[0], torch.diag(torch.from_numpy(NOISE**2)))
    assert not begun.steps.told[0].any()
    assert begun.steps.told[1].all()


def test_a_measurement_counts_where_the_model_has_no_finite_answer():
    found = tracker(Delay())
    first = torch.tensor([0.3, torch.nan]).double()
    _, track = found.observe(first, found.begin(first))
    now = torch.tensor([0.1, 0.2]).double()
    _, track = found.observe(now, found.after(track, torch.ones(1).double()))
    torch.testing.assert_close(track.states, now)


def test_without_a_model_states_are_what_is_measured():
    found = StateTracker(StatePredictor(Delay(1), None), 1)
    now = torch.tensor([0.3, -0.2]).double()
    for _ in range(2):
        seen, track = found.observe(now, found.begin(now))
        assert torch.equal(seen, now)
        track = found.after(track, torch.ones(1).double())


def test_what_is_observed_is_the_prediction_of_the_track():
    """After the delay, under the commands that are on their way."""
    _, measured, commands = recorded(6, FREQUENCY)
    found, y = tracker(Delay(2)), torch.from_numpy(measured)
    memory = found.begin(y[0])
    for t, u in enumerate(commands):
        seen, memory = found.observe(y[t], memory)
        assert memory.steps is not None
        past = torch.from_numpy(np.append(commands[:t][::-1], [0.0, 0.0])[:2].copy())[:, None]
        expected = found.predictor.after(memory.steps)(memory.states, past)
        torch.testing.assert_close(seen, expected)
        memory = found.after(memory, torch.tensor([u]))


# --- the noise of measurements --------------------------------------------------------------------


def noise_found(
    noise: np.ndarray, seed: int, steps: int = 150, prior_std: float | None = 2.0
) -> np.ndarray:
    """What is found of a recorded oscillator that is pushed at random."""
    rng = np.random.default_rng(seed)
    commands, states = rng.uniform(-3, 3, steps), [np.array([0.3, -0.1])]
    for acting in (0.0, *commands[:-1]):
        states.append(moved(states[-1], acting, DT, 3.0))
    measured = np.array(states) + noise * rng.normal(size=(steps + 1, 2))
    rows = Transitions(measured[:-1], commands[:, None], measured[1:]).after_inputs(1)
    numbers = ModelConfig(delay=DT, noise_floor=0.001, prior_std=prior_std)
    model = Model(numbers, oscillator(DT))
    model.fit(rows)
    return model.tracker(rows).noise_std.numpy()


@pytest.mark.parametrize("noise", [(0.01, 0.03), (0.03, 0.01)])
@pytest.mark.parametrize("seed", range(4))
def test_noise_is_found_in_each_state(noise: tuple[float, float], seed: int) -> None:
    # what noise in the one state does to the change of the other is counted with the other's
    expected = np.hypot(noise, np.array([DT / np.sqrt(2), 9 * DT]) * noise[::-1] / np.sqrt(2))
    np.testing.assert_allclose(noise_found(np.array(noise), seed), expected, rtol=0.25)


def test_of_positions_it_is_found_in_few_steps() -> None:
    assert noise_found(np.array([0.03, 0.01]), seed=0, steps=30)[0] == pytest.approx(0.03, rel=0.3)


def test_exact_states_have_next_to_none() -> None:
    q, v = noise_found(np.zeros(2), seed=0, prior_std=None)  # which would hold a part of it
    assert v == pytest.approx(0.001 / np.sqrt(2), rel=0.01)  # the floor
    assert q < 2e-4  # 5e-4, were positions taken to follow at constant acceleration


UNDAMPED = 3.0
"""of an oscillator without friction [rad/s]"""


def predicted(state: np.ndarray, commands: list[float], samples: float, dt: float, frequency):
    """Where a state is after the delay, by a predictor whose model knows the velocity."""
    delay = Delay.of(samples * dt, dt)
    past = torch.tensor(commands[: delay.memory]).double()[:, None]
    predictor = StatePredictor(delay, known_dynamics(delay, dt, frequency))
    return predictor(torch.from_numpy(state), past).numpy()


@pytest.mark.parametrize("samples", [1, 2, 0.5, 1.5, 2.25])
def test_a_mass_without_a_spring_is_predicted_exactly(samples):
    start, commands = np.array([0.3, -0.5]), [2.0, -6.0, 9.0, -1.0]
    found = predicted(start, commands, samples, 0.1, 0.0)
    np.testing.assert_allclose(found, late(start, commands, samples, 0.1, 0.0), atol=1e-12)


@pytest.mark.parametrize("samples", [0.5, 1.5, 2.25])
def test_errors_of_an_oscillator_fall_with_the_third_power_of_a_sample(samples):
    start, commands = np.array([0.3, -0.5]), [2.0, -6.0, 9.0, -1.0]
    errors = [
        np.abs(
            predicted(start, commands, samples, dt, UNDAMPED)
            - late(start, commands, samples, dt, UNDAMPED)
        ).max()
        for dt in (0.02, 0.01)
    ]
    assert 0 < errors[1] < errors[0] / 6


def test_a_batch_is_predicted_as_each_of_it():
    states, past = torch.randn(3, 2, 2), torch.randn(3, 2, 1, 1)
    dynamics = GPDynamics(
        SimpleNamespace(mean=lambda asked: asked[..., 2:].sin()),
        AngleAugmentation(2, ()),
        speed_integration(oscillator(0.1)),
        np.array([np.inf]),
    )
    predictor = StatePredictor(Delay(1), dynamics)
    together = predictor(states.double(), past.double())
    for i, j in np.ndindex(3, 2):
        alone = predictor(states[i, j].double(), past[i, j].double())
        torch.testing.assert_close(together[i, j], alone)
