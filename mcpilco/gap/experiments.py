"""What to record next: what these recordings cannot show, and what would tell a family apart."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, fit, run, settle
from mcpilco.gap.name import TIED, Rival, rivals
from mcpilco.gap.search import Found
from mcpilco.gap.windows import Windows, cut
from mcpilco.plant import EffectInstance
from mcpilco.recordings import PARTS, Part, Recording

LENGTH_S, REPEATS = 10.0, 4
"""of a recording that is designed [s], and parts in it"""
FELT = 1.0
"""signature of a probe, in noise std, below which an effect five times as large goes unseen"""
LISTED = 6
"""effects that a sentence names"""


def experiments(found: Found, best: Fit, windows: Windows) -> list[str]:
    """Sentences on what to record next.

    Args:
        found: the search.
        best: its best model, fitted.
        windows: to which.
    """
    told = _unexcited(found)
    for active in best.model.named:
        tied = [r for r in rivals(found, active) if r.behind < TIED and not r.holds(active)]
        if tied:
            told.append(_told_apart(active, tied[0], best, windows))
    return told


def _unexcited(found: Found) -> list[str]:
    """What would not show, of the effects that the best model does not have."""
    felt: dict[EffectInstance, float] = {}
    for score in found.scores:
        felt[score.active] = max(score.felt, felt.get(score.active, 0.0))
    unseen = [str(active) for active, most in felt.items() if most < FELT]
    if not unseen:
        return []
    more = f" and {len(unseen) - LISTED} more" if len(unseen) > LISTED else ""
    return [
        f"These recordings would hardly show {', '.join(unseen[:LISTED])}{more}: "
        "record larger, faster and slower motion (`mcpilco record --policy excitation`)."
    ]


def _told_apart(active: EffectInstance, rival: Rival, best: Fit, windows: Windows) -> str:
    """The kind of motion in which two models differ most, and how much in simulation."""
    by_kind = {part.__name__: separation(best, rival.fit, part, windows) for part in PARTS}
    kind = max(by_kind, key=lambda name: by_kind[name])
    if by_kind[kind] < TIED:
        return (
            f"{active} and {rival.active} stay alike under every kind of input that was simulated: "
            "only another sensor tells them apart."
        )
    return (
        f"To tell {active} from {rival.active}, record {_WORDS[kind]}: in simulation, "
        f"{LENGTH_S:g} s of it leave the other {math.sqrt(by_kind[kind]):.0f} noise std off."
    )


_WORDS = {
    "multisine": "a multisine",
    "chirp": "a chirp",
    "slow": "small, slow triangles",
    "pulses": "pulses up to the limits",
    "holds": "constant inputs in both directions",
}


def separation(best: Fit, rival: Fit, part: Part, windows: Windows) -> float:
    """Least squared misfit, in noise variances, of a model on what another would be measured as.

    Args:
        best: the model that is simulated, without noise.
        rival: the model that is fitted to it.
        part: what kind of input.
        windows: of the recordings, for their sampling time, noise and largest commands.
    """
    designed = _simulated(best, part, windows)
    some = cut([designed], windows.std)
    starts = settle(rival.model, some, rival.theta)
    return float(fit(rival.model, some, rival.theta, starts, iterations=12).by_window.sum())


def _simulated(best: Fit, part: Part, windows: Windows) -> Recording:
    """A recording of a model from rest under some parts of a kind."""
    layout, dt = best.model.plant.layout, windows.dt
    rng = np.random.default_rng(0)
    time = dt * np.arange(round(LENGTH_S / REPEATS / dt))
    largest = np.abs(windows.commands).max(axis=(0, 1))
    inputs: Float[np.ndarray, "T U"] = np.stack(
        [limit * np.concatenate([part(time, rng) for _ in range(REPEATS)]) for limit in largest],
        axis=1,
    )
    T = len(inputs)
    whole = replace(
        windows[:1],
        y=np.zeros((1, 2 * len(layout.joints), T)),
        commands=np.concatenate([np.zeros((1, windows.lead, inputs.shape[1])), inputs[None]], 1),
    )
    rest = np.zeros((1, 1, 2 * len(layout.joints)))
    y = run(best.model, whole, best.theta[None], rest)[0, 0]
    states = np.where(windows.measured.any(axis=(0, 2)), y.T, np.nan)
    return Recording("designed", dt * np.arange(T), states, inputs, layout.states, layout.inputs)
