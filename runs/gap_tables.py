"""The results of a gap analysis, as Markdown tables that several runs share."""

from __future__ import annotations

from mcpilco.gap import IN_SAMPLE, Gap
from mcpilco.sweep import markdown

MODELS = "nominal", "refit", "corrected", "noise_floor"
"""whose errors are told"""


def effects_table(gap: Gap) -> str:
    """The verdict, and what is named with its intervals."""
    rows = [
        (
            named.name,
            named.target,
            ", ".join(
                f"{symbol} = {e.value:.4g} {e.unit} ({e.low:.4g} to {e.high:.4g})"
                for symbol, e in named.parameters.items()
            ),
            f"{100 * named.probability:.0f}",
            ", ".join(named.family[1:]) or "-",
        )
        for named in gap.named
    ]
    header = ("effect", "at", "95 % interval", "probability [%]", "or")
    return f"Verdict: **{gap.verdict}**.\n\n{markdown(header, rows)}"


def errors_table(gap: Gap) -> str:
    """Free runs on the recordings that were held out, a row for each position.

    Args:
        gap: of recordings that were not too poor.
    """
    found = gap.comparison
    assert found is not None
    layout = gap.plant.layout
    rows = []
    for state, by_model in found.channels.items():
        unit = layout.units[layout.states.index(state)]
        cells = [f"{by_model[model]:.4f}" for model in MODELS]
        rows.append((f"{state} [{unit}]", *cells, _below(by_model["refit"], by_model["corrected"])))
    together = (found.nominal, found.refit, found.corrected, found.noise_floor)
    cells = [f"{value:.2f}" for value in together]
    rows.append(("mean [noise std]", *cells, _below(found.refit, found.corrected)))
    header = ("error of", *(m.replace("_", " ") for m in MODELS), "corrected below refit [%]")
    names = ", ".join(f"`{name}`" for name in gap.compared)
    seen = "which no fit has seen" if gap.held_out else IN_SAMPLE
    return (
        f"Free runs of {found.horizon_s:g} s on {names}, {seen}, rms at their "
        f"end, {len(found.windows)} windows:\n\n{markdown(header, rows)}"
    )


def steps_table(gap: Gap) -> str:
    """How the held-out error shrinks as one thing after the other is added."""
    assert gap.comparison is not None
    rows = [
        (step.added, f"{step.error.value:.2f} ({step.error.low:.2f} to {step.error.high:.2f})")
        for step in gap.comparison.steps
    ]
    return f"Step by step:\n\n{markdown(('with', 'error [noise std]'), rows)}"


def events_table(gap: Gap) -> str:
    """The events that were left out."""
    rows = [(e.recording, f"{e.start_s:.1f}", f"{e.end_s:.1f}") for e in gap.events]
    if not rows:
        return "Nothing was left out as an event."
    return f"Left out as events:\n\n{markdown(('recording', 'from [s]', 'to [s]'), rows)}"


def _below(refit: float, corrected: float) -> str:
    return f"{100.0 * (1.0 - corrected / refit):.0f}"
