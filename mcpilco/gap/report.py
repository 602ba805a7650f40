"""What was found, as a file and as ten lines for an engineer."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from mcpilco.files import write_bytes
from mcpilco.gap.investigate import Gap
from mcpilco.gap.where import Disagreement

FORMAT = 1
HIDDEN = "On these held-out recordings noise hides how much of the gap is closed."


def to_json(gap: Gap) -> dict[str, Any]:
    """The content of `gap.json`."""
    return {
        "format": FORMAT,
        "plant": gap.plant.name,
        "verdict": gap.verdict,
        "effects": [
            {
                "name": named.name,
                "target": named.target,
                "parameters": {symbol: vars(e) for symbol, e in named.parameters.items()},
                "probability": named.probability,
                "family": list(named.family),
            }
            for named in gap.named
        ],
        "where": [_place(part) for part in gap.where],
        "error": _error(gap),
        "events": [vars(event) for event in gap.events],
        "experiments": list(gap.experiments),
        "recordings": {"train": list(gap.train), "held_out": list(gap.held_out)},
    }


def _place(part: Disagreement) -> dict[str, Any]:
    """A disagreement; the joint only where it is one in a joint."""
    return {name: value for name, value in vars(part).items() if name != "joint" or value}


def _error(gap: Gap) -> dict[str, Any] | None:
    if gap.comparison is None:
        return None
    found = gap.comparison
    return {
        "horizon_s": found.horizon_s,
        "nominal": found.nominal,
        "refit": found.refit,
        "corrected": found.corrected,
        "noise_floor": found.noise_floor,
        "closed": vars(found.closed),
        "hidden": found.hidden,
        "channels": found.channels,
        "steps": [{"added": step.added, **vars(step.error)} for step in found.steps],
    }


def write_json(gap: Gap, path: Path) -> None:
    """Writes `gap.json`, whole or not at all; what is not finite becomes null."""
    text = json.dumps(_finite(to_json(gap)), indent=2, allow_nan=False)
    write_bytes(path, text.encode())


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def summary(gap: Gap) -> list[str]:
    """Some lines that an engineer can act on."""
    lines = [f"{gap.plant.name}: {verdict(gap)}"]
    for named in gap.named:
        numbers = ", ".join(
            f"{symbol} = {e.value:.4g} {e.unit} ({e.low:.4g} to {e.high:.4g})"
            for symbol, e in named.parameters.items()
        )
        others = named.family[1:]
        instead = f"; it could be {' or '.join(others)} as well" if others else ""
        sure = f"{100 * named.probability:.0f} %"
        lines.append(f"  {named.name} at {named.target}, {sure}: {numbers}{instead}")
    lines += [f"  At {part.joint} {part.condition} is missing." for part in gap.where if part.joint]
    missed = [part for part in gap.where if not part.joint]
    if missed:
        share = f"{100 * missed[0].share:.0f} % of the misfit"
        lines.append(f"Missed most is {missed[0].channel} ({share}), {missed[0].condition}.")
    if gap.comparison is not None:
        found = gap.comparison
        lines.append(
            f"Error after {found.horizon_s:g} s on held-out recordings, in noise std: nominal "
            f"{short(found.nominal)}, refitted {short(found.refit)}, corrected "
            f"{short(found.corrected)}, noise alone {short(found.noise_floor)}."
        )
    if gap.comparison is not None and gap.mended:
        closed = gap.comparison.closed
        lines.append(
            HIDDEN
            if gap.comparison.hidden
            else f"The gap is closed by {100 * closed.value:.1f} % "
            f"({100 * closed.low:.1f} to {100 * closed.high:.1f})."
        )
    if gap.corrected.learned:
        lines.append("What is missing was learned as a force, which corrected.json holds.")
    lines += [
        f"Left out: {event.recording} from {event.start_s:.1f} to {event.end_s:.1f} s, "
        "which no model explains."
        for event in gap.events
    ]
    return lines + list(gap.experiments)


def cautions(gap: Gap) -> list[str]:
    """What a reader of the numbers must not miss."""
    said = [
        f"Instead of {named.name} at {named.target} it could be {' or '.join(named.family[1:])}: "
        "these recordings cannot tell."
        for named in gap.named
        if named.family[1:]
    ]
    if gap.verdict == "unknown":
        said.append(
            "What is left over is no noise, and no effect of the catalogue explains it: "
            + (
                "a force without a name was learned in its place. Away from what was recorded it "
                "is 0."
                if gap.corrected.learned
                else "no force of state and command that predicts held-out recordings better was "
                "found either; the times of the misfit tell where to look."
            )
        )
    said += [
        f"{event.recording} was left out from {event.start_s:.1f} to {event.end_s:.1f} s, for no "
        "model explains it: a push, a contact, a fault of the log?"
        for event in gap.events
    ]
    if gap.comparison is not None and gap.mended and gap.comparison.hidden:
        said.append(HIDDEN)
    if not set(gap.train).isdisjoint(gap.held_out) and gap.comparison is not None:
        said.append(
            "The errors are of recordings that were fitted too; record three or more to have some "
            "held out."
        )
    return said


def short(value: float) -> str:
    """A number with three digits, large ones without an exponent."""
    return f"{value:.0f}" if 1000.0 <= abs(value) < 1e7 else f"{value:.3g}"


def verdict(gap: Gap) -> str:
    """The verdict as a sentence."""
    if gap.verdict == "named" and len(gap.named) > 1:
        return f"{len(gap.named)} effects are missing in the plant."
    return _VERDICTS[gap.verdict]


_VERDICTS = {
    "named": "an effect is missing in the plant.",
    "none": "the plant explains the recordings; nothing is missing.",
    "unknown": "something is missing that is not in the catalogue.",
    "too_poor": "the recordings are too poor to name anything.",
}
