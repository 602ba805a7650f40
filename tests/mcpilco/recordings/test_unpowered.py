"""Where an amplifier was off, commands count for nothing; sound recordings lose nothing."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import envs
from mcpilco.gap import investigate
from mcpilco.recordings import unpowered_spans, without_unpowered
from tests.mcpilco.gap import pendulum as rods
from tests.mcpilco.gap.machines import DT, SECONDS, columns
from tests.mcpilco.gap.machines import recorded as simulated

PLANTS = {
    "pendulum": envs.PLANTS["mcpilco/Pendulum-v0"](),
    "cart_pole": envs.PLANTS["mcpilco/CartPoleSwingUp-v0"](),
}
recorded = cache(simulated)


@pytest.mark.one_in(2)
@pytest.mark.parametrize("gain", [0.6, 1.0, 1.4])
@pytest.mark.parametrize("machine", list(PLANTS))
def test_what_is_recorded_before_an_amplifier_is_enabled_is_left_out(
    machine: str, gain: float
) -> None:
    for gaps in unpowered_spans(PLANTS[machine], recorded(machine, 0, gain=gain, off=(0.0, 0.7))):
        ((start, end),) = gaps
        assert start == 0.0
        assert 0.6 <= end <= 1.0


@pytest.mark.parametrize("machine", list(PLANTS))
def test_what_is_recorded_after_it_is_switched_off_is_left_out(machine: str) -> None:
    for gaps in unpowered_spans(
        PLANTS[machine], recorded(machine, 0, off=(SECONDS - 0.7, SECONDS))
    ):
        ((start, end),) = gaps
        assert SECONDS - 1.4 <= start <= SECONDS - 0.6  # some spans before tell little
        assert end == pytest.approx(SECONDS - DT)


def test_one_recording_among_others_is_told_from_them() -> None:
    sound, late = recorded("pendulum", 1), recorded("pendulum", 1, off=(0.0, 1.0))
    kept, remarks = without_unpowered(PLANTS["pendulum"], [sound[0], late[1], sound[2]])
    assert kept[0] is sound[0]
    assert kept[2] is sound[2]
    assert np.isnan(kept[1].states[1:40]).all()
    assert np.isfinite(kept[1].states[70:]).all()
    (told,) = remarks
    assert told.startswith("recording_1: until ")
    assert "nothing answers to the commands" in told


@pytest.mark.one_in(6)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gain", [0.4, 1.0, 1.5])
@pytest.mark.parametrize("machine", list(PLANTS))
def test_sound_recordings_lose_nothing(machine: str, gain: float, seed: int) -> None:
    assert not any(unpowered_spans(PLANTS[machine], recorded(machine, seed, gain=gain)))


@pytest.mark.one_in(4)
@pytest.mark.parametrize(
    ("force", "how"),
    [
        pytest.param(rods.dry_friction(0.4), {}, id="friction"),
        pytest.param(lambda q, v: -2.0 * q, {}, id="spring"),
        pytest.param(lambda q, v: 0.5, {}, id="offset"),
        pytest.param(lambda q, v: 0.0, {"delay": 0.2}, id="delay"),
    ],
)
def test_strong_effects_are_no_amplifier_that_is_off(
    force: rods.Force, how: dict[str, float]
) -> None:
    rng = np.random.default_rng(6)
    measured = [rods.record(rng, force, number, **how) for number in range(3)]
    assert not any(unpowered_spans(PLANTS["pendulum"], measured))


@pytest.mark.parametrize("change", [lambda u: 0.0 * u, lambda u: -u, lambda u: 1e3 * u])
def test_a_column_that_never_helps_tells_nothing(change: Callable) -> None:
    wrong = columns(recorded("pendulum", 0), torque=change)
    assert not any(unpowered_spans(PLANTS["pendulum"], wrong))


def test_an_investigation_says_what_it_leaves_out() -> None:
    late = recorded("pendulum", 0, off=(0.0, 0.7))
    short = [one.without([(2.4, SECONDS)]) for one in late]
    gap = investigate(PLANTS["pendulum"], short)
    assert gap.verdict == "too_poor"
    assert len(gap.remarks) == len(late)
    assert all("as if the actuators were off" in remark for remark in gap.remarks)


@pytest.mark.slow
def test_a_gain_is_named_beside_an_amplifier_that_was_off() -> None:
    gap = investigate(PLANTS["pendulum"], recorded("pendulum", 2, gain=0.7, off=(0.0, 0.7)))
    (named,) = gap.named
    assert named.family[0] in ("actuator_gain", "body_mass", "center_of_mass")
    assert gap.verdict == "named"
