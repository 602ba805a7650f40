"""Which effects are named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import envs
from mcpilco.gap.fit import Fit, fit, settle
from mcpilco.gap.given import Given
from mcpilco.gap.model import Model
from mcpilco.gap.name import certain
from mcpilco.gap.search import Found
from mcpilco.gap.windows import Windows
from mcpilco.plant import CATALOGUE, EffectInstance
from tests.mcpilco.gap.pendulum import dry_friction, record

FRICTION = EffectInstance(CATALOGUE["coulomb_friction"], "pendulum")
SPRING = EffectInstance(CATALOGUE["spring"], "pendulum")
OFFSET = EffectInstance(CATALOGUE["sensor_offset"], "angle")
SIZES = {FRICTION: (0.1, 2e-3), SPRING: (0.02,), OFFSET: (0.01,)}


@pytest.fixture(scope="module")
def rubbing() -> tuple[Model, Windows]:
    """Windows of a pendulum with Coulomb friction, and the model without effects."""
    rng = np.random.default_rng(0)
    recordings = [record(rng, dry_friction(0.1), number) for number in range(2)]
    known = Given.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = known.windows()
    return known.model(windows), windows


def found(nominal: Model, windows: Windows, effects: list[EffectInstance]) -> tuple[Found, Fit]:
    """A search that ended with these effects, and their fit."""
    model, theta = nominal, np.zeros(nominal.nuisances)
    null = fit(model, windows, theta, settle(model, windows, theta))
    for active in effects:
        model, theta = model.grown(theta, active, SIZES[active])
    best = fit(model, windows, theta, settle(model, windows, theta))
    return Found(best, null, (), (), windows).with_best(best, [null, best]), best


@pytest.mark.parametrize(
    "none", [[SPRING], [OFFSET], [SPRING, OFFSET]], ids=["spring", "offset", "both"]
)
def test_effects_that_may_be_none_are_not_named(
    rubbing: tuple[Model, Windows], none: list[EffectInstance]
) -> None:
    nominal, windows = rubbing
    before, best = found(nominal, windows, [FRICTION, *none])
    search, kept, names = certain(before, best, before.null, windows)
    assert search.best.model.named == kept.model.named == (FRICTION,)
    assert {frozenset(f.model.named) for f in before.fits} < {
        frozenset(f.model.named) for f in search.fits
    }
    (named,) = names
    assert named.parameters["f_c"].low < 0.1 < named.parameters["f_c"].high


def test_an_effect_alone_that_may_be_none_is_not_named(
    rubbing: tuple[Model, Windows],
) -> None:
    nominal, windows = rubbing
    friction = nominal.plant.having([(FRICTION, (0.1, 2e-3))])
    before, best = found(replace(nominal, plant=friction), windows, [SPRING])
    search, kept, names = certain(before, best, before.null, windows)
    assert not search.best.model.named
    assert not kept.model.named
    assert names == ()
