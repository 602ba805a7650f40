"""The result of an investigation: as a file, as sentences, and as recordings to make next."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.data import html_table
from mcpilco.files import finite, write_bytes
from mcpilco.gap.comparison import ComparedModels, Comparison, Interval
from mcpilco.gap.data import Event, Windows, cut
from mcpilco.gap.decide import Closest, LeftForce, NamedEffect, Rival, ShiftedParameter, rivals
from mcpilco.gap.disagreement import Disagreement
from mcpilco.gap.fit import Fit, fit_initial_states, fit_model
from mcpilco.gap.search import SearchResult
from mcpilco.gap.sensitivities import run
from mcpilco.gap.thresholds import SEARCH, VERDICT
from mcpilco.plant import Correction, EffectInstance, Member, Plant, correction_of
from mcpilco.recordings import PARTS, Part, Recording, doubts, repeated_part


@dataclass(frozen=True)
class Gap:
    """The result of an investigation."""

    plant: Plant
    """nominal"""
    verdict: str
    """named, none, partly (effects are named, and more is missing), unknown or too_poor"""
    corrected: Plant
    """the plant with the effects, its uncertain parameters as the data have them"""
    train: tuple[str, ...]
    """names of the recordings that were fitted"""
    held_out: tuple[str, ...]
    """names of those that no fit has seen, and on which the models are compared; none where there
    are too few: then they are compared on those that were fitted"""
    experiments: tuple[str, ...]
    """recordings that would decide what these cannot"""
    named: tuple[NamedEffect, ...] = ()
    """effects that are missing"""
    where: tuple[Disagreement, ...] = ()
    """where the nominal plant disagrees with the recordings"""
    comparison: Comparison | None = None
    """errors on held-out recordings; None where the data are too poor"""
    apart: bool = False
    """whether these errors are of held-out windows that did not decide the verdict"""
    events: tuple[Event, ...] = ()
    """spans that no model explains: a push, a contact"""
    search: SearchResult | None = None
    """all sets of effects that were fitted"""
    models: ComparedModels | None = None
    """the models that were compared, to look at them further"""
    recordings: tuple[Recording, ...] = ()
    """all of them"""
    suspicions: tuple[str, ...] = ()
    """what looks wrong with them, which leads the verdict"""
    remarks: tuple[str, ...] = ()
    """which of them were left out, as they hold the same as others"""
    left: tuple[LeftForce, ...] = ()
    """the random forces that the effects leave over, one a joint"""
    shifted: tuple[ShiftedParameter, ...] = ()
    """parameters of the corrected plant that are farther from the nominal ones than was told"""
    on_bounds: tuple[str, ...] = ()
    """values of effects that lie on a bound"""
    closest: Closest | None = None
    """where none is named: the effects that come closest, and may but imitate what is missing"""
    spread: tuple[Member, ...] = ()
    """the plants that the recordings allow, around the corrected one"""

    @property
    def correction(self) -> Correction:
        """The correction that makes the corrected plant of the nominal one, with its spread."""
        return replace(correction_of(self.corrected, self.plant), spread=self.spread)

    @property
    def compared(self) -> tuple[str, ...]:
        """Names of the recordings on which the models are compared."""
        return self.held_out or self.train

    @property
    def mended(self) -> bool:
        """Whether the corrected plant has effects or learned forces that the nominal one lacks."""
        added = self.corrected.added[len(self.plant.added) :]
        return bool(self.named or added or self.corrected.learned)

    def _repr_html_(self) -> str:
        """The verdict, a row for each parameter of a missing effect, and the errors."""
        rows = [
            {
                "missing effect": named.name,
                "at": named.target,
                "sure [%]": f"{100 * named.probability:.0f}",
                "parameter": f"{symbol} = {e.value:.4g} {e.unit}".removesuffix(" -"),
                "95 %": f"{e.low:.4g} to {e.high:.4g}",
            }
            for named in self.named
            for symbol, e in named.parameters.items()
        ]
        sentences = (summary(self)[0], *_errors(self))
        about, *errors = (f"<p>{escape(sentence)}</p>" for sentence in sentences)
        return "".join([about, html_table(rows) if rows else "", *errors])


FORMAT = 1
HIDDEN = "On these recordings noise hides how much of the gap is closed."
IN_SAMPLE = "in-sample: nothing was held out"


def to_json(gap: Gap) -> dict[str, Any]:
    """The content of `gap.json`."""
    return {
        "format": FORMAT,
        "plant": gap.plant.name,
        "suspicions": list(gap.suspicions),
        "verdict": gap.verdict,
        "effects": [asdict(named) for named in gap.named],
        # a joint only where the disagreement is in one
        "where": [{k: v for k, v in vars(part).items() if k != "joint" or v} for part in gap.where],
        "error": _error(gap),
        "left": [vars(force) for force in gap.left],
        "shifted": [vars(parameter) for parameter in gap.shifted],
        "on_bounds": list(gap.on_bounds),
        "closest": gap.closest
        and {
            "effects": [asdict(effect) for effect in gap.closest.effects],
            "reduction": vars(gap.closest.reduction),
        },
        "events": [vars(event) for event in gap.events],
        "experiments": list(gap.experiments),
        "recordings": {
            "train": list(gap.train),
            "held_out": list(gap.held_out),
            "errors_are": errors_are(gap),
            "remarks": list(gap.remarks),
            "doubts": doubt_lines(gap),
        },
    }


def errors_are(gap: Gap) -> str:
    """Of which recordings errors are told, and whether these decided the verdict too."""
    if not gap.held_out:
        return IN_SAMPLE
    decided = "decided nothing" if gap.apart else "also decided the verdict, as they are few"
    return f"of held-out windows that {decided}"


def _error(gap: Gap) -> dict[str, Any] | None:
    if (compared := gap.comparison) is None:
        return None
    names = "horizon_s", "nominal", "refit", "corrected", "noise_floor", "hidden", "channels"
    return {
        **{name: getattr(compared, name) for name in names},
        "closed": {**vars(compared.closed), "from": compared.baseline},
        "units": {name: _units(gap)[name] for name in compared.channels},
        "with_events": compared.everywhere,
        "steps": [{"added": step.added, **vars(step.error)} for step in compared.steps],
    }


def write_json(gap: Gap, path: Path) -> None:
    """Writes `gap.json`, whole or not at all; what is not finite becomes null."""
    text = json.dumps(finite(to_json(gap)), indent=2, allow_nan=False)
    write_bytes(path, text.encode())


def summary(gap: Gap) -> list[str]:
    """The result as some lines that an engineer can act on."""
    lines = [f"{gap.plant.name}: {verdict_sentence(gap)}", *shift_lines(gap), *gap.remarks]
    lines += map(_effect_line, gap.named)
    lines += [*map("  {}".format, gap.on_bounds), *_left(gap)]
    lines += [f"  Missing at {part.joint}: {part.condition}." for part in gap.where if part.joint]
    for part in [part for part in gap.where if not part.joint][:1]:
        share = f"{100 * part.share:.0f} % of the misfit"
        lines.append(f"The residual is largest in {part.channel} ({share}), {part.condition}.")
    lines += _errors(gap)
    if gap.corrected.learned:
        lines.append("The missing force was learned from the recordings; it is in corrected.json.")
    return list(dict.fromkeys([*lines, *left_out_lines(gap), *doubt_lines(gap), *gap.experiments]))


def _effect_line(named: NamedEffect) -> str:
    numbers = ", ".join(
        f"{symbol} = {e.value:.4g} {e.unit}".removesuffix(" -") + f" ({e.low:.4g} to {e.high:.4g})"
        for symbol, e in named.parameters.items()
    )
    others = named.family[1:]
    instead = f"; cannot be distinguished from {' or '.join(others)}" if others else ""
    sure = f"{100 * named.probability:.0f} %, closes {100 * named.share:.0f} % of the gap"
    return f"  {named.name} at {named.target}, {sure}: {numbers}{instead}"


def shift_lines(gap: Gap) -> list[str]:
    """Sentences on parameters far from their nominal values."""
    return [
        f"The correction takes {p.name} from {p.nominal:.4g} to {p.value:.4g} {p.unit}, "
        f"{p.stds:.0f} standard deviations of what was told of it (`--uncertainty`)."
        for p in gap.shifted
    ]


def _left(gap: Gap) -> list[str]:
    """Sentences on the forces that effects leave over, where they are more than is usual."""
    if gap.verdict not in ("partly", "unknown"):
        return []
    said = []
    if gap.closest is not None:
        part = percent(gap.closest.reduction)
        said = [
            f"  Closest, and too little or too unsure to be named: {part} of the refitted plant's "
            "error is gone with these; closest.json has them.",
            *map(_effect_line, gap.closest.effects),
        ]
    return said + [
        f"  Left over at {force.joint}: a force of {force.std:.2g} {force.unit} rms, "
        f"{100 * force.usual:.0f} % of the usual one; in the nominal plant {force.nominal:.2g}."
        for force in gap.left
        if force.usual > SEARCH.least_force
    ]


def _errors(gap: Gap) -> list[str]:
    """Sentences on the errors of the plants."""
    if gap.comparison is None:
        return []
    errors, units = gap.comparison, _units(gap)
    where = "on held-out recordings" if gap.held_out else f"({IN_SAMPLE})"
    told = ", ".join(f"{said} {three_digits(getattr(errors, n))}" for n, said in PLANTS.items())
    lines = [f"Error after {errors.horizon_s:g} s {where}, in noise std: {told}."]
    if gap.events:
        whole = errors.everywhere.items()
        told = ", ".join(f"{PLANTS[name]} {three_digits(error)}" for name, error in whole)
        lines.append(f"With what was left out: {told}.")
    for name, parts in errors.channels.items():
        each = [f"{PLANTS[plant]} {part:.3g}" for plant, part in parts.items()]
        lines.append(f"Of {name}, in {units[name]}: {', '.join(each)}.")
    if gap.mended:
        lines.append(HIDDEN if errors.hidden else f"The gap is closed by {closed_share(errors)}.")
    return lines + runaway_lines(gap)


PLANTS = {
    "nominal": "nominal",
    "refit": "refitted",
    "corrected": "corrected",
    "noise_floor": "noise alone",
}
"""what the errors are told of, by their names in a comparison"""


def closed_share(found: Comparison) -> str:
    """How much of the gap is closed, with the ends of its interval, and from where it counts."""
    return f"{percent(found.closed)}, from the {PLANTS[found.baseline]} plant"


def percent(part: Interval) -> str:
    """A part, at most all, with the ends of its interval."""
    value, low, high = (100 * min(each, 1.0) for each in (part.value, part.low, part.high))
    ends = f"{low:.1f} to {high:.1f}" if math.isfinite(low) else "too few windows for an interval"
    return f"{value:.1f} % ({ends})"


def _units(gap: Gap) -> dict[str, str]:
    """The unit of each state."""
    return dict(zip(gap.plant.layout.states, gap.plant.layout.units, strict=True))


def left_out_lines(gap: Gap) -> list[str]:
    """A line for each recording with events; what is missing may act in unseen ones alone."""
    spans: dict[str, list[str]] = {}
    for event in gap.events:
        span = f"{event.start_s:.1f} to {event.end_s:.1f} s"
        spans.setdefault(event.recording, []).append(span)
    alone = gap.verdict == "unknown" and {*spans} <= {*gap.held_out}
    hint = " No fit has seen that: hold other recordings out (`--held-out`)." if alone else ""
    return [
        f"Left out of {name}, as no model explains it: {', '.join(each)}.{hint}"
        for name, each in spans.items()
    ]


def doubt_lines(gap: Gap) -> list[str]:
    """A line for each recording with columns that look wrong, none of which was refused."""
    by_name = {one.name: " ".join(doubts(one)) for one in gap.recordings}
    return [f"Doubtful in {name}: {said}" for name, said in by_name.items() if said]


def runaway_lines(gap: Gap) -> list[str]:
    """A sentence on each plant whose free runs do not all reach the end of their windows."""
    if gap.comparison is None or gap.models is None:
        return []
    after = {name: gap.comparison.runs_away_s(name) for name in gap.models.shown}
    return [
        f"The {name} plant runs away in {np.isfinite(lost).sum()} of {len(lost)} windows, first "
        f"{lost.min():.2g} s after the start of one."
        for name, lost in after.items()
        if np.isfinite(lost).any()
    ]


def far_from_noise(compared: Comparison, more: bool) -> tuple[str, ...]:
    """A sentence where the corrected plant is far from explaining the recordings.

    There may be `more` that acts on this machine than effects explain.
    """
    most = VERDICT.unlearned if more else VERDICT.unexplained
    if compared.corrected <= most * compared.noise_floor:
        return ()
    return (
        f"the corrected plant misses the recordings by {three_digits(compared.corrected)} noise "
        f"std, noise alone by {three_digits(compared.noise_floor)}: is the plant the right one?",
    )


def three_digits(value: float) -> str:
    """A number with three digits, large ones without an exponent."""
    return f"{value:.0f}" if 1000.0 <= abs(value) < 1e7 else f"{value:.3g}"


def verdict_sentence(gap: Gap) -> str:
    """The verdict as a sentence."""
    missing = f"{len(gap.named)} effects are" if len(gap.named) > 1 else "an effect is"
    said = _VERDICTS[gap.verdict].format(f"{missing} missing in the plant")
    if gap.comparison is not None and not gap.held_out:
        said = f"{said.rstrip('.')} ({IN_SAMPLE})."
    if not gap.suspicions:
        return said
    return f"this looks wrong: {' '.join(gap.suspicions)} Taken as it is, {said}"


_VERDICTS = {
    "named": "{}.",
    "partly": "{}, and something else that is not in the catalogue.",
    "none": "the plant explains the recordings; nothing is missing.",
    "unknown": "something is missing that is not in the catalogue.",
    "too_poor": "the recordings are too poor to name anything.",
}

LENGTH_S, REPEATS = 10.0, 4
"""of a recording that is designed [s], and parts in it"""
LISTED = 6
"""effects that a sentence names"""


def experiments(result: SearchResult, best: Fit, windows: Windows) -> list[str]:
    """Sentences on what to record next, after a search and the fit of its best model to windows."""
    sentences = _unexcited(result)
    for effect in best.model.effects:
        tied = [rival for rival in rivals(result, effect) if not rival.instance.holds(effect)]
        sentences += [_told_apart(effect, rival, best, windows) for rival in tied[:1]]
    return sentences


def _unexcited(result: SearchResult) -> list[str]:
    """A sentence on the effects that these recordings have little power to detect, if any."""
    sensitivity: dict[EffectInstance, float] = {}
    for score in result.scores:
        sensitivity[score.instance] = max(score.sensitivity, sensitivity.get(score.instance, 0.0))
    unseen = [str(effect) for effect, most in sensitivity.items() if most < VERDICT.unseen]
    if not unseen:
        return []
    more = f" and {len(unseen) - LISTED} more" if len(unseen) > LISTED else ""
    return [
        f"These recordings have little power to detect {', '.join(unseen[:LISTED])}{more}: "
        "record larger, faster and slower motion (`mcpilco record --policy excitation`)."
    ]


def _told_apart(effect: EffectInstance, rival: Rival, best: Fit, windows: Windows) -> str:
    """The kind of motion in which two models differ most, and how much in simulation."""
    by_kind = {kind: separation(best, rival.fit, part, windows) for kind, part in PARTS.items()}
    kind = max(by_kind, key=lambda name: by_kind[name])
    if by_kind[kind] < VERDICT.tied:
        return (
            f"{effect} and {rival.instance} cannot be distinguished by any kind of input that was "
            "simulated: measure another quantity."
        )
    return (
        f"To distinguish {effect} from {rival.instance}, record {kind}: if the first acts, "
        f"the second leaves a residual of norm {math.sqrt(by_kind[kind]):.0f} noise std in "
        f"{LENGTH_S:g} s of it, by simulation."
    )


def separation(best: Fit, rival: Fit, part: Part, windows: Windows) -> float:
    """Least squared misfit of a rival on simulated measurements of the best [noise variances].

    The part is the kind of input; windows tell the sampling time, noise and largest commands.
    """
    windows = cut([_simulated(best, part, windows)], windows.std)
    x0 = fit_initial_states(rival.model, windows, rival.theta)
    return float(fit_model(rival.model, windows, rival.theta, x0, iterations=12).by_window.sum())


def _simulated(best: Fit, part: Part, windows: Windows) -> Recording:
    """A recording of a model from rest under some parts of a kind."""
    layout, dt = best.model.plant.layout, windows.dt
    inputs = repeated_part(part, np.abs(windows.commands).max(axis=(0, 1)), LENGTH_S, REPEATS, dt)
    T = len(inputs)
    whole = replace(
        windows[:1],
        y=np.zeros((1, 2 * len(layout.joints), T)),
        commands=np.pad(inputs.repeat(windows.every, axis=0), ((windows.lead, 0), (0, 0)))[None],
    )
    rest = np.zeros((1, 1, 2 * len(layout.joints)))
    y = run(best.model, whole, best.theta[None], rest)[0, 0]
    states = np.where(windows.measured.any(axis=(0, 2)), y.T, np.nan)
    return Recording("designed", dt * np.arange(T), states, inputs, layout.states, layout.inputs)
