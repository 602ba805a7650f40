"""When effects that were found are what recordings lack, and when something else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap import verdict
from mcpilco.gap.fit import Fit, fit, settle
from mcpilco.gap.given import Given
from mcpilco.gap.residual_force import Explained
from mcpilco.gap.show import Interval
from mcpilco.gap.where import Structure
from mcpilco.gap.windows import Windows
from mcpilco.plant import CATALOGUE, EffectInstance
from tests.mcpilco.gap.pendulum import record

WHITE = Structure(whiteness=2.0, excess=0.0, usual=0.0, unevenness=1.5)


@pytest.fixture(scope="module")
def nominal() -> tuple[Fit, Windows]:
    """The nominal fit of recordings in which nothing is hidden."""
    rng = np.random.default_rng(0)
    measured = [record(rng, lambda q, v: 0.0, number) for number in range(2)]
    given = Given.of(envs.PLANTS["mcpilco/Pendulum-v0"](), measured, 0.01, (), {})
    windows = given.windows()
    model = given.model(windows)
    theta = np.zeros(model.nuisances)
    return fit(model, windows, theta, settle(model, windows, theta)), windows


def missed(found: Fit, windows: Windows, usual: float, once: float) -> Fit:
    """The fit, its windows missed alike but for one."""
    by_window = usual * windows.samples
    by_window[3] = once * windows.samples[3]
    return replace(found, by_window=by_window, chi2=float(by_window.sum()))


@pytest.mark.parametrize(
    ("usual", "left", "gap", "unknown"),
    [
        pytest.param(1.0, 9.0, 9.0, True, id="missed-once"),
        pytest.param(1.0, 3.0, 300.0, False, id="mended-for-the-most-part"),
        pytest.param(3.0, 4.0, 4.0, False, id="noise-is-larger-than-told"),
        pytest.param(3.0, 9.0, 9.0, True, id="missed-once-in-such-noise"),
        pytest.param(40.0, 200.0, 200.0, False, id="a-machine-that-no-model-fits"),
    ],
)
def test_a_window_that_is_missed_alone_is_not_passed_over(
    nominal: tuple[Fit, Windows],
    monkeypatch: pytest.MonkeyPatch,
    usual: float,
    left: float,
    gap: float,
    unknown: bool,
) -> None:
    found, windows = nominal
    best, null = (missed(found, windows, usual, once) for once in (left, gap))
    monkeypatch.setattr(verdict, "structure", lambda found, windows: WHITE)
    assert verdict.something_else(best, null, windows) == unknown


def test_noise_alone_is_nothing_else(nominal: tuple[Fit, Windows]) -> None:
    found, windows = nominal
    assert not verdict.something_else(found, found, windows)


@pytest.mark.parametrize(
    ("closed", "low", "held_out", "fitted", "usual", "bad"),
    [
        (0.9, 0.8, 50.0, 1.0, 1.0, False),
        (0.3, 0.2, 1.2, 1.0, 1.0, False),
        (0.3, 0.2, 4.0, 1.0, 1.0, True),
        (0.3, 0.2, 4.0, 3.0, 1.0, False),
        (0.6, 0.2, 4.0, 1.0, 1.0, False),
        (0.6, 0.2, 4.0, 3.0, 50.0, True),
        (0.6, 0.55, 4.0, 3.0, 50.0, False),
    ],
)
def test_effects_that_leave_the_held_out_error_are_not_what_is_missing(
    nominal: tuple[Fit, Windows],
    monkeypatch: pytest.MonkeyPatch,
    closed: float,
    low: float,
    held_out: float,
    fitted: float,
    usual: float,
    bad: bool,
) -> None:
    null, windows = nominal
    armature = EffectInstance(CATALOGUE["armature"], "pendulum")
    model, theta = null.model.grown(null.theta, armature, [0.01])
    best = replace(missed(null, windows, usual, usual), model=model, theta=theta)
    clear = windows[:5]
    beyond = {len(windows): fitted, len(clear): held_out}
    monkeypatch.setattr(verdict, "shrunk", lambda *fits: Interval(closed, low, 1.0))
    monkeypatch.setattr(verdict, "beyond_noise", lambda found, some: beyond[len(some)])
    assert verdict.mispredicts(best, null, windows, clear) == bad
    assert not verdict.mispredicts(null, null, windows, clear)


@pytest.mark.parametrize(("usual", "unknown"), [(0.5, False), (50.0, True)])
def test_a_gap_that_is_closed_in_few_windows_alone_is_not_named(
    nominal: tuple[Fit, Windows], monkeypatch: pytest.MonkeyPatch, usual: float, unknown: bool
) -> None:
    """Few windows make nearly all of the misfit: they are explained, the usual ones are not."""
    found, windows = nominal
    told = iter(
        (
            Structure(whiteness=1e4, excess=60.0, usual=usual, unevenness=1.5),
            Structure(whiteness=1e4, excess=1e5, usual=60.0, unevenness=900.0),
        )
    )
    monkeypatch.setattr(verdict, "structure", lambda found, windows: next(told))
    monkeypatch.setattr(verdict, "explain", lambda response: Explained(0.0, np.zeros(1)))
    assert verdict.something_else(found, found, windows) == unknown
