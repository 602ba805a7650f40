from __future__ import annotations

import numpy as np
import pytest

import envs
from mcpilco.gap.bursts import bursts, unforeseen
from mcpilco.gap.fit import Fit
from mcpilco.gap.learn import SHORT_S
from mcpilco.gap.model import Model, scales
from mcpilco.gap.windows import Windows, cut
from mcpilco.recordings import Recording
from tests.mcpilco.gap.pendulum import STD, Force, Outside, record

PUSH_S = 4.0, 4.6
"""[s]"""


def nothing(q: float, v: float) -> float:
    return 0.0


def push(time: float) -> float:
    return 0.4 if PUSH_S[0] <= time < PUSH_S[1] else 0.0


def nominal(
    force: Force = nothing, outside: Outside = lambda time: 0.0
) -> tuple[Fit, Windows, list[Recording]]:
    """The pendulum without effects, beside two recordings in the first of which a hand may push."""
    rng = np.random.default_rng(3)
    recordings = [record(rng, force, 1, outside=outside), record(rng, force, 2)]
    short = cut(recordings, np.array([STD, 1.0]), SHORT_S, 0.5 * SHORT_S)
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    model = Model(plant, (), {}, scales(plant, short))
    return Fit(model, np.zeros(0), short.guess, 0.0, np.zeros(len(short))), short, recordings


def test_a_weak_push_is_found_when_it_was() -> None:
    known, short, recordings = nominal(outside=push)
    spans = bursts(known, short, recordings)
    assert [span.recording for span in spans] == ["recording_1"]
    assert spans[0].start_s == pytest.approx(PUSH_S[0], abs=0.75 * SHORT_S)
    assert spans[0].end_s == pytest.approx(PUSH_S[1], abs=0.75 * SHORT_S)
    assert unforeseen(spans, known, short, recordings) == spans


def test_noise_holds_no_burst() -> None:
    assert bursts(*nominal()) == ()


@pytest.mark.parametrize(("width", "size"), [(0.15, 0.6), (0.1, 3.0)])
def test_what_a_magnet_does_wherever_the_pendulum_comes_by_is_no_event(
    width: float, size: float
) -> None:
    def detent(q: float, v: float) -> float:
        return -size * (q - 0.1) / width * float(np.exp(-(((q - 0.1) / width) ** 2)))

    known, short, recordings = nominal(detent)
    spans = bursts(known, short, recordings)
    assert spans
    assert unforeseen(spans, known, short, recordings) == ()
