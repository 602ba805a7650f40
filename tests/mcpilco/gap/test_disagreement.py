"""Events: pushes and contacts, once and wherever a machine comes by."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import envs
from mcpilco.gap import disagreement
from mcpilco.gap.data import Event, GapProblem, Windows, cut, usual_scales
from mcpilco.gap.disagreement import (
    bursts,
    recurring,
    still_missed,
    unforeseen,
    windows_with_events,
    without_bursts,
    without_spikes,
)
from mcpilco.gap.fit import Fit, fit_nominal, on_windows
from mcpilco.gap.plant_model import ComputeBudget, PlantModel
from mcpilco.gap.thresholds import FORCE
from mcpilco.plant import EffectInstance
from mcpilco.plant.effects import CATALOGUE
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import STD, Force, Outside, record

PUSH_S = 4.0, 4.6
"""[s]"""


def nothing(q: float, v: float) -> float:
    return 0.0


def push(time: float) -> float:
    return 0.4 if PUSH_S[0] <= time < PUSH_S[1] else 0.0


@cache
def nominal(
    force: Force = nothing, outside: Outside = lambda time: 0.0, every: int = 1
) -> tuple[Fit, Windows, list[Recording]]:
    """The pendulum without effects, beside two recordings in the first of which a hand may push.

    They have one in so many samples.
    """
    rng = np.random.default_rng(3)
    recordings = [record(rng, force, 1, outside=outside), record(rng, force, 2)]
    recordings = [recording.every_nth(every) for recording in recordings]
    short = cut(recordings, np.array([STD, 1.0]), FORCE.short_s, 0.5 * FORCE.short_s)
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    model = PlantModel(plant, (), {}, usual_scales(plant, short))
    return Fit(model, np.zeros(0), short.guess, np.zeros(len(short))), short, recordings


def test_a_weak_push_is_found_when_it_was() -> None:
    known, short, recordings = nominal(outside=push)
    spans = bursts(known, short, recordings)
    assert [span.recording for span in spans] == ["recording_1"]
    assert spans[0].start_s == pytest.approx(PUSH_S[0], abs=0.75 * FORCE.short_s)
    assert spans[0].end_s == pytest.approx(PUSH_S[1], abs=0.75 * FORCE.short_s)
    assert unforeseen(spans, known, short, recordings) == spans


def test_a_push_is_found_in_samples_that_are_far_apart() -> None:
    known, short, recordings = nominal(outside=push, every=5)
    (span,) = bursts(known, short, recordings)
    assert span.recording == "recording_1"
    assert PUSH_S[0] - short.dt * short.y.shape[2] <= span.start_s <= PUSH_S[0]
    assert PUSH_S[1] <= span.end_s <= PUSH_S[1] + short.dt * short.y.shape[2]


def test_a_push_is_left_out_though_the_steps_are_used_up() -> None:
    known, _, recordings = nominal(outside=push)
    problem = GapProblem.of(known.model.plant, recordings, 0.01, (), {})
    windows = problem.windows()
    best, _ = fit_nominal(problem.model(windows), windows)
    spent = replace(problem, budget=ComputeBudget(0.0))
    quiet, (span,) = without_bursts(spent, best)
    assert span.start_s == pytest.approx(PUSH_S[0], abs=FORCE.short_s)
    assert quiet.recordings == problem.without([span]).recordings


def test_noise_holds_no_burst() -> None:
    assert bursts(*nominal()) == ()


@pytest.mark.parametrize(
    ("width", "size"), [pytest.param(0.15, 0.6, marks=pytest.mark.slow), (0.1, 3.0)]
)
def test_what_a_magnet_does_wherever_the_pendulum_comes_by_is_no_event(
    width: float, size: float
) -> None:
    def detent(q: float, v: float) -> float:
        return -size * (q - 0.1) / width * float(np.exp(-(((q - 0.1) / width) ** 2)))

    known, short, recordings = nominal(detent)
    spans = bursts(known, short, recordings)
    assert spans
    assert unforeseen(spans, known, short, recordings) == ()


DT, SECONDS, COUNT = 0.02, 20.0, 3


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    """A pendulum that swings up to 1 rad and back, at a pace that changes."""
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    time = DT * np.arange(round(SECONDS / DT) + 1)
    made = []
    for number in range(COUNT):
        pace = 1.3 + 0.3 * number
        angle = np.sin(pace * time + 0.2 * np.sin(0.7 * time))
        states = np.stack([angle, np.gradient(angle, DT)], axis=1)
        layout = plant.layout
        names = layout.states, layout.inputs
        made.append(Recording(f"r{number}", time, states, np.zeros((len(time), 1)), *names))
    return GapProblem.of(plant, made, 0.01, (), {"angle": 1e-3})


def where(problem: GapProblem, low: float, high: float) -> list[Event]:
    """An event for each visit to an interval of the angle."""
    found = []
    for recording in problem.recordings:
        inside = (recording.states[:, 0] > low) & (recording.states[:, 0] < high)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
        for first, last in edges.reshape(-1, 2):
            found.append(Event(recording.name, DT * float(first), DT * float(last)))
    return found


def test_what_happens_whenever_a_machine_comes_by_is_told_with_its_place(
    problem: GapProblem,
) -> None:
    place = recurring(where(problem, 0.7, 0.95), problem)
    assert place is not None
    assert (place.channel, place.joint) == ("angle", "pendulum")
    low, high = (float(word) for word in place.condition.split() if word[0].isdigit())
    assert 0.3 < low < 0.8 < high < 1.01
    assert 0.5 < place.share <= 1.0


@pytest.mark.parametrize("seed", range(5))
def test_events_at_any_time_are_no_place(problem: GapProblem, seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [recording.name for recording in problem.recordings]
    spans = [
        Event(str(rng.choice(names)), begin, begin + float(rng.uniform(0.3, 1.5)))
        for begin in map(float, rng.uniform(0.5, SECONDS - 2.0, 6))
    ]
    assert recurring(spans, problem) is None


def test_few_events_at_a_place_where_more_visits_are_without_are_none(problem: GapProblem) -> None:
    assert recurring(where(problem, 0.7, 0.95)[:3], problem) is None


def test_one_event_recurs_nowhere_though_it_holds_all_visits_to_a_place(
    problem: GapProblem,
) -> None:
    """The pendulum comes by 1.8 rad four times while it lasts, and never else."""
    first, *others = problem.recordings
    lasts = (first.time > 8.0) & (first.time < 12.0)
    angle = np.where(lasts, 1.5 + 0.4 * np.sin(2.0 * np.pi * first.time), first.states[:, 0])
    states = np.stack([angle, np.gradient(angle, DT)], axis=1)
    once = replace(problem, recordings=(replace(first, states=states), *others))
    assert len(where(once, 1.7, 1.9)) >= 4
    assert recurring([Event(first.name, 8.0, 12.0)], once) is None
    assert recurring(where(once, 1.7, 1.9), once) is not None


def test_without_events_there_is_no_place(problem: GapProblem) -> None:
    assert recurring([], problem) is None


@pytest.mark.parametrize(("dt", "torque"), [(0.005, 2.0), (0.02, 1.0)])
def test_what_a_wrong_plant_misses_of_a_fast_swing_is_no_spike_but_a_wrong_reading_is(
    dt: float, torque: float
) -> None:
    """An elbow that whips round at 40 or 80 rad/s, its arm heavier than the plant has it."""
    rng, plant = np.random.default_rng(0), envs.PLANTS["mcpilco/Pendubot-v0"]()
    layout, std = plant.layout, np.array([1e-3, 1e-2, 1e-3, 1e-2])
    u = np.repeat(rng.uniform(-torque, torque, 40), round(0.4 / dt))[:, None]
    true = plant.where(lower_mass=0.66).simulate(np.zeros((1, 4)), u[None, :-1], dt)[0]
    true += std * rng.standard_normal(true.shape)
    wrong, places = true.copy(), rng.choice(np.arange(3, len(true) - 3), len(true) // 100, False)
    wrong[places] += 100.0 * std
    for states, misread in ((true, places[:0]), (wrong, places)):
        time = dt * np.arange(len(u))
        one = Recording("swing", time, states, u, layout.states, layout.inputs)
        windows = cut([one], std)
        model = PlantModel(plant, (), {}, usual_scales(plant, windows))
        guess = Fit(model, np.zeros(0), windows.guess, np.zeros(len(windows)))
        seen = without_spikes(on_windows(guess, windows), windows).measured
        numbers = (windows.start_s[:, None] / dt + np.arange(windows.y.shape[2])).round()
        of_these = np.isin(numbers.astype(int), misread)[:, None] & windows.measured
        assert (seen | of_these)[windows.measured].all()
        assert (of_these & ~seen).sum() >= 0.8 * of_these.sum()


@pytest.mark.parametrize("last", [1, 2, pytest.param(3, marks=pytest.mark.slow)])
def test_a_wrong_reading_near_the_end_of_a_window_is_one_and_its_neighbours_are_none(
    last: int,
) -> None:
    known, short, _ = nominal()
    y = short.y.copy()
    y[::3, 0, -last] += 40.0 * STD
    wrong = replace(short, y=y)
    seen = without_spikes(on_windows(known, wrong), wrong).measured
    misread = np.zeros_like(seen)
    misread[::3, 0, -last] = True
    assert ((seen | misread) == short.measured).all()
    assert not (seen & misread).any()


@pytest.mark.parametrize(
    ("first", "apart"), [(-3, 2), (-4, 1), (-4, 2), (6, 1), (6, 2), (10, 1), (10, 2)]
)
def test_two_wrong_readings_beside_one_another_hide_neither(first: int, apart: int) -> None:
    known, short, _ = nominal()
    y, misread = short.y.copy(), np.zeros(short.measured.shape, dtype=bool)
    for place, error in ((first, 40.0), (first + apart, -45.0)):
        y[::3, 0, place] += error * STD
        misread[::3, 0, place] = True
    wrong = replace(short, y=y)
    seen = without_spikes(on_windows(known, wrong), wrong).measured
    assert ((seen | misread) == short.measured).all()
    assert not (seen & misread).any()


def test_the_widest_swings_hold_no_event_if_a_model_can_be_fitted_to_them_but_a_push_is_one():
    """A spring that only these tell, and a hand; the other windows are those of small swings."""
    rng, plant = np.random.default_rng(3), envs.PLANTS["mcpilco/Pendulum-v0"]()
    recordings = [
        record(rng, lambda q, v: -0.04 * q**3, 1, outside=push),
        record(rng, lambda q, v: -0.04 * q**3, 2),
    ]
    windows = cut(recordings, np.array([STD, 1.0]))
    spring = EffectInstance(CATALOGUE["hardening_spring"], "pendulum")
    model = PlantModel(plant, (spring,), {}, usual_scales(plant, windows))
    swing = np.nanmax(np.abs(windows.y[:, 0]), axis=1)
    pushed = (windows.recording == 0) & (windows.start_s < PUSH_S[1])
    pushed &= windows.start_s + windows.y.shape[2] * windows.dt > PUSH_S[0]
    wide, narrow = (swing > 1.45) & ~pushed, (swing < 1.0) & ~pushed
    small, masked = windows[narrow], windows[wide | pushed]
    without = Fit(model, np.zeros(1), small.guess, np.zeros(len(small)))
    before, _ = still_missed(on_windows(without, small), small, masked)
    assert len(before) == len(masked) > pushed.sum() > 0
    missed, fine = still_missed(on_windows(without, small), small, masked, train=(0, 1))
    assert len(fine) == wide.sum()
    np.testing.assert_array_equal(missed.start_s, windows.start_s[pushed])


def test_what_masses_2_percent_off_miss_where_an_elbow_whips_round_is_no_burst() -> None:
    rng, plant = np.random.default_rng(0), envs.PLANTS["mcpilco/Pendubot-v0"]()
    u, std = np.repeat(rng.uniform(-1.0, 1.0, 60), 20)[:, None], np.array([1e-3, 1e-2, 1e-3, 1e-2])
    heavier = {"lower_mass": 1.02 * plant.values["lower_mass"]}
    true = plant.where(**heavier).simulate(np.zeros((1, 4)), u[None, :-1], 0.02)[0]
    states = true + std * rng.standard_normal(true.shape)
    time = 0.02 * np.arange(len(u))
    one = Recording("swing", time, states, u, plant.layout.states, plant.layout.inputs)
    short = cut([one], std, FORCE.short_s, 0.5 * FORCE.short_s)
    model = PlantModel(plant, (), {}, usual_scales(plant, short))
    fit = Fit(model, np.zeros(0), short.guess, np.zeros(len(short)))
    assert bursts(fit, short, [one]) == ()


def test_where_no_window_is_missed_by_much_no_force_is_sought(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    known, short, _ = nominal()

    def sought(*_: object) -> None:
        raise AssertionError

    monkeypatch.setattr(disagreement, "force_response", sought)
    assert not windows_with_events(on_windows(known, short), short).any()
