"""The recordings that a gap asks for, and how a notebook shows it."""

from __future__ import annotations

from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest

import envs
from mcpilco.gap import (
    Closest,
    EstimatedParameter,
    Event,
    Gap,
    NamedEffect,
    investigate,
    summary,
    to_json,
)
from mcpilco.gap.comparison import Interval
from mcpilco.gap.report import HIDDEN, far_from_noise, percent
from mcpilco.gap.thresholds import VERDICT
from mcpilco.recordings import Recording
from mcpilco.show.report.gap_page import cautions
from tests.mcpilco.gap.pendulum import record

PLANT = envs.PLANTS["mcpilco/Pendulum-v0"]


@pytest.mark.slow
def test_a_gain_and_what_it_is_confused_with_get_an_experiment_or_a_plain_no() -> None:
    rng = np.random.default_rng(7)
    measured = [record(rng, lambda q, v: 0.0, number, gain=1.3) for number in range(3)]
    gap = investigate(PLANT(), measured)
    family = gap.named[0].family
    sentences = [s for s in gap.experiments if "actuator_gain" in s]
    assert bool(family[1:]) == bool(sentences)
    shown = ElementTree.fromstring(f"<div>{gap._repr_html_()}</div>")
    told = ("mcpilco/Pendulum-v0: ", "Error after ", "Of angle, ", "The gap is closed ", HIDDEN)
    expected = [line for line in summary(gap) if line.startswith(told)]
    assert [line.text for line in shown.iter("p")] == expected
    assert len(expected) >= 2


def test_a_notebook_shows_a_row_for_each_parameter_of_a_missing_effect() -> None:
    found = EstimatedParameter(0.52, 0.5, 0.54, "N m")
    missing = NamedEffect("coulomb", "hinge", {"c": found, "d": found}, 0.98, 1.0, ("coulomb",))
    nothing = Gap(PLANT(), "none", PLANT(), (), (), ())
    gap = replace(nothing, verdict="named", named=(missing,))
    shown = ElementTree.fromstring(f"<div>{gap._repr_html_()}</div>")
    _, first, second = ([cell.text for cell in line] for line in shown.iter("tr"))
    assert first == ["coulomb", "hinge", "98", "c = 0.52 N m", "0.5 to 0.54"]
    assert second[3] == "d = 0.52 N m"
    assert "<table>" not in nothing._repr_html_()


def test_a_number_without_a_unit_has_no_dash_behind_it(found: Gap) -> None:
    size = EstimatedParameter(0.5, 0.49, 0.51, "-")
    gain = NamedEffect("actuator_gain", "actuator", {"k": size}, 1.0, 1.0, ("actuator_gain",))
    gap = replace(found, named=(gain,))
    assert any(line.endswith("k = 0.5 (0.49 to 0.51)") for line in summary(gap))
    assert "<td>k = 0.5</td>" in gap._repr_html_()


@pytest.mark.slow
def test_what_small_motion_cannot_show_is_listed() -> None:
    """Five thousandths of the usual torque: nothing speeds up enough for drag to show."""
    rng = np.random.default_rng(8)
    whole = [record(rng, lambda q, v: 0.0, number) for number in range(3)]
    dt, plant = whole[0].dt, PLANT()
    small = []
    for recording in whole:
        torque = 5e-3 * recording.inputs
        motion = plant.simulate(np.zeros((1, 2)), torque[None], dt)[0, :-1]
        angle = motion[:, 0] + 2e-3 * rng.standard_normal(len(torque))
        states = np.stack([angle, np.full(len(torque), np.nan)], axis=1)
        names = recording.state_names, recording.input_names
        small.append(Recording(recording.name, recording.time, states, torque, *names))
    found = [s for s in investigate(plant, small).experiments if "little power" in s]
    assert len(found) == 1
    slow = ("quadratic_drag", "hardening_spring", "stribeck_friction", "load_dependent_friction")
    assert any(name in found[0] for name in slow)


def test_errors_of_fitted_recordings_are_not_called_held_out(found: Gap) -> None:
    alone = replace(found, train=(*found.train, *found.held_out), held_out=())
    assert "on held-out recordings" in " ".join(summary(found))
    told = " ".join([*summary(alone), *cautions(alone)])
    assert summary(alone)[0].endswith("(in-sample: nothing was held out).")
    assert "in-sample" not in summary(found)[0]
    assert "The errors are in-sample: nothing was held out" in told
    assert "on held-out recordings" not in told
    assert to_json(alone)["recordings"]["held_out"] == []
    assert to_json(alone)["recordings"]["errors_are"] == "in-sample: nothing was held out"


def test_a_suspicion_leads_the_verdict(found: Gap) -> None:
    doubted = replace(found, suspicions=("negate torque?",))
    assert summary(doubted)[0].startswith(f"{found.plant.name}: this looks wrong: negate torque?")
    assert to_json(doubted)["suspicions"] == ["negate torque?"]
    assert cautions(doubted)[0] == "negate torque?"
    assert doubted._repr_html_().startswith(f"<p>{summary(doubted)[0]}</p>")


def test_errors_are_told_in_radians_beside_noise_std_and_closed_says_from_where(
    found: Gap,
) -> None:
    assert found.comparison is not None
    lines, error = summary(found), to_json(found)["error"]
    angle = found.comparison.channels["angle"]
    (told,) = [line for line in lines if line.startswith("Of angle, in rad: ")]
    assert f"nominal {angle['nominal']:.3g}, refitted {angle['refit']:.3g}" in told
    assert f"noise alone {angle['noise_floor']:.3g}." in told
    assert error["units"] == {"angle": "rad"}
    (closed,) = [line for line in lines if line.startswith("The gap is closed by ")]
    assert closed.endswith(", from the nominal plant.")
    assert error["closed"]["from"] == "nominal"


def test_an_effect_that_is_a_parameter_of_the_plant_closes_a_gap_like_any_other(found: Gap) -> None:
    heavier = replace(found, corrected=found.plant.where(mass=1.0))
    assert any(line.startswith("The gap is closed by") for line in summary(heavier))
    assert not replace(heavier, named=()).mended


def test_a_recording_with_events_has_one_line_and_the_errors_with_them(found: Gap) -> None:
    assert found.comparison is not None
    assert not any("left out" in line.lower() for line in summary(found))
    events = tuple(Event("recording_1", start, start + 0.5) for start in (2.0, 4.0))
    more = {name: 2.0 * value for name, value in found.comparison.everywhere.items()}
    pushed = replace(found, events=events, comparison=replace(found.comparison, everywhere=more))
    lines = summary(pushed)
    said = "Left out of recording_1, as no model explains it: 2.0 to 2.5 s, 4.0 to 4.5 s."
    assert lines.count(said) == 1
    assert sum("recording_1" in line for line in lines) == 1
    assert any(line.startswith("With what was left out: nominal ") for line in lines)
    assert len(set(lines)) == len(lines)
    assert to_json(pushed)["error"]["with_events"] == more
    assert any(line.startswith(said) for line in cautions(pushed))


def test_what_only_unseen_recordings_show_is_told_as_that(found: Gap) -> None:
    """A motor's limit may be reached in none of the recordings that are fitted."""
    unknown = replace(found, verdict="unknown", named=(), held_out=("recording_3",))
    hint = "No fit has seen that: hold other recordings out (`--held-out`)."

    def said(*names: str) -> bool:
        events = tuple(Event(name, 2.0, 2.5) for name in names)
        return any(line.endswith(hint) for line in summary(replace(unknown, events=events)))

    assert said("recording_3")
    assert not said("recording_1")
    assert not said("recording_1", "recording_3")


def test_a_doubtful_column_is_told_in_the_summary(found: Gap) -> None:
    assert not any("Doubtful" in line for line in summary(found))
    first = found.recordings[0]
    spiky = first.inputs.copy()
    spiky[50] = 17.0
    doubted = replace(found, recordings=(replace(first, inputs=spiky), *found.recordings[1:]))
    told = [line for line in summary(doubted) if line.startswith(f"Doubtful in {first.name}: ")]
    assert len(told) == 1
    assert "torque is 17 at most, from 1.000 s on" in told[0]
    assert told[0] in cautions(doubted)
    assert to_json(doubted)["recordings"]["doubts"] == told


def test_what_comes_closest_is_told_with_its_numbers_though_it_is_not_named(found: Gap) -> None:
    closest = Closest(found.named, Interval(0.78, -0.09, 0.96), found.corrected)
    gap = replace(found, verdict="unknown", named=(), corrected=found.plant, closest=closest)
    lines = summary(gap)
    (at,) = (n for n, line in enumerate(lines) if "78.0 % (-9.0 to 96.0)" in line)
    assert "too unsure to be named" in lines[at]
    assert lines[at + 1].startswith("  coulomb_friction at pendulum, ")
    told = to_json(gap)["closest"]
    assert told["effects"][0]["parameters"]["f_c"] == vars(found.named[0].parameters["f_c"])
    assert told["reduction"] == {"value": 0.78, "low": -0.09, "high": 0.96}
    assert to_json(found)["closest"] is None


def test_a_corrected_plant_that_is_far_from_the_noise_is_told(found: Gap) -> None:
    assert found.comparison is not None
    assert far_from_noise(found.comparison, more=False) == ()
    far = 2.0 * VERDICT.unexplained * found.comparison.noise_floor
    missed = replace(found.comparison, corrected=far)
    (told,) = far_from_noise(missed, more=False)
    assert "is the plant the right one?" in told
    assert far_from_noise(missed, more=True) == ()  # which is told as unknown


def test_no_more_than_all_of_a_gap_is_closed() -> None:
    """Errors below what noise makes by estimate."""
    assert percent(Interval(1.4, 0.931, 1.9)) == "100.0 % (93.1 to 100.0)"
    assert percent(Interval(0.5, -0.2, 1.2)) == "50.0 % (-20.0 to 100.0)"
