"""The page of a gap: what a plant lacks, how that shows, and what adding it is worth."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mcpilco.gap import (
    HIDDEN,
    IN_SAMPLE,
    Closest,
    ComparedModels,
    Comparison,
    EstimatedParameter,
    Gap,
    NamedEffect,
    SearchResult,
    closed_share,
    doubt_lines,
    left_out_lines,
    percent,
    runaway_lines,
    scaled_errors,
    shift_lines,
    squares_at_end,
    three_digits,
    verdict_sentence,
)
from mcpilco.plant import Plant
from mcpilco.recordings import Recording
from mcpilco.show.plots import gap as plots
from mcpilco.show.report.document import (
    Document,
    Picture,
    Section,
    Table,
    draw,
    made,
    write_document,
)
from mcpilco.show.report.gap_maps import FORCE_SPAN_S, MissingForce, missing_force, time_map


def write_gap_report(gap: Gap, path: Path) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    Raises:
        RunFolderError: the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    return write_document(path, page_of(gap))


def page_of(gap: Gap) -> Document:
    """The content of the page of a gap."""
    return Document(
        title=f"{gap.plant.name}: {verdict_sentence(gap).rstrip('.')}",
        about=f"simulation against {len({*gap.train, *gap.held_out})} recordings",
        tiles=_tiles(gap),
        sections=_sections(gap),
        cautions=cautions(gap),
        cautions_title="What to mind",
    )


def cautions(gap: Gap) -> list[str]:
    """Sentences that a reader of the numbers must not miss."""
    said = [*gap.suspicions, *gap.remarks, *doubt_lines(gap)]
    said += [
        f"{named.name} at {named.target} cannot be distinguished from "
        f"{' or '.join(named.family[1:])} in these recordings."
        for named in gap.named
        if named.family[1:]
    ]
    said += [*shift_lines(gap), *(gap.on_bounds if gap.named else ())]
    if gap.verdict in ("partly", "unknown"):
        learned = ": a force was learned in its place, which is 0 outside the recorded range."
        missed = ", nor does a learned force of state and command predict held-out recordings "
        missed += "better. “When they disagree” shows when the residual is large."
        explained = "The best model's residual is not noise; no effect of the catalogue explains it"
        said.append(explained + (learned if gap.corrected.learned else missed))
    said += [f"{line} A push, a contact, a fault of the log?" for line in left_out_lines(gap)]
    said += runaway_lines(gap)
    if gap.comparison is not None and gap.mended and gap.comparison.hidden:
        said.append(HIDDEN)
    if not gap.held_out and gap.comparison is not None:
        said.append(f"The errors are {IN_SAMPLE}; record three or more, each with other commands.")
    return said


def _tiles(gap: Gap) -> list[tuple[str, str]]:
    tiles = [("verdict", gap.verdict.replace("_", " "))]
    found = gap.comparison
    if found is None:
        return tiles
    if gap.mended and not found.hidden:
        value, ends = closed_share(found).split(" (")
        tiles.append((f"of the gap is closed ({ends}", value))
    after = f"after {found.horizon_s:g} s, in noise std"
    name = "corrected" if gap.mended else "refitted"
    return [
        *tiles,
        (f"nominal error {after}", three_digits(found.nominal)),
        (f"{name} error {after}", three_digits(found.corrected)),
        ("error of noise alone", three_digits(found.noise_floor)),
    ]


def _sections(gap: Gap) -> Iterator[Section]:
    """All sections; one that cannot be made says why."""
    if gap.named:
        yield made("What is missing", effects, gap)
    if gap.closest is not None:
        yield made("What comes closest", closest, gap, gap.closest)
    if gap.corrected.learned:
        yield made("What was learned", learned, gap)
    if gap.comparison is not None:
        yield made(f"Errors on {_kind(gap)} recordings", worth, gap, gap.comparison)
    if gap.models is not None:
        yield made("The force that is left over", force, gap, gap.models)
        yield made("When they disagree", when, gap, gap.models)
    if gap.comparison is not None:
        yield made(f"{_kind(gap).capitalize()} windows", windows, gap, gap.comparison)
    if gap.experiments:
        yield made("What to record next", experiments, gap)
    if gap.search is not None:
        yield made("What was compared", candidates, gap, gap.search)
    if gap.recordings:
        yield made("Recordings", recordings, gap)


_JOINTS = 3
"""whose force is shown: those that are missed most"""
_PARTS = 0.9, 0.5, 0.1
"""of the held-out windows in which a plant is better than in one that is shown"""
_SETS = 12
"""of effects that are listed"""
_HEADS = {"refit": "refitted", "noise_floor": "noise alone"}
"""of columns of errors, where they are not the names in a comparison"""


def effects(gap: Gap) -> Section:
    """The effects that are missing, with their sizes."""
    return Section(
        "The smallest set of effects that explains the recordings. Those under “not "
        "distinguishable from” leave residuals of about the same size in these recordings.",
        tables=[_sizes(gap.plant, gap.named)],
    )


def closest(gap: Gap, closest: Closest) -> Section:
    """The effects that explain too little to be named."""
    return Section(
        f"With these effects {percent(closest.reduction)} of the refitted plant's error is gone: "
        "too little, or too unsure, to name them. They may but imitate what is missing. "
        "closest.json is the plant with them.",
        tables=[_sizes(gap.plant, closest.effects)],
    )


def _sizes(plant: Plant, effects: Sequence[NamedEffect]) -> Table:
    rows = []
    for named in effects:
        sizes = "; ".join(
            f"{symbol} = {interval(estimate)}" for symbol, estimate in named.parameters.items()
        )
        formula = (plant.catalogue[named.name].__doc__ or "").splitlines()[0].rstrip(".")
        others = ", ".join(named.family[1:]) or "–"
        sure = f"{100 * named.probability:.0f} %"
        rows.append((named.name, named.target, sizes, sure, others, formula))
    header = (
        "effect",
        "at",
        "size (95 % interval)",
        "probability",
        "not distinguishable from",
        "what it does",
    )
    return Table(header, rows)


def learned(gap: Gap) -> Section:
    """The joints and regions in which a force was learned."""
    rows = [
        (part.joint, part.condition, f"{100 * part.share:.0f} %")
        for part in gap.where
        if part.joint
    ]
    return Section(
        "No effect of the catalogue explains the residual. A force of state and command was "
        "learned in its place; it is in corrected.json, and 0 outside the recorded range. An MJCF "
        "file cannot contain it. The range given is the shortest that holds most of the force.",
        tables=[Table(("joint", "missing there", "share of the force"), rows)],
    )


def interval(estimate: EstimatedParameter) -> str:
    """A value with its unit and 95 % interval."""
    ends = f"{estimate.low:.4g} to {estimate.high:.4g}"
    return f"{estimate.value:.4g} {estimate.unit}".removesuffix(" -") + f" ({ends})"


def worth(gap: Gap, found: Comparison) -> Section:
    """The errors on held-out recordings, or on the fitted ones, and how they shrink."""
    times = found.windows.dt * np.arange(found.windows.y.shape[2])
    steps = [step.error for step in found.steps]
    names = [name for name in found.over_time if gap.mended or name != "corrected"]
    errors_over_time = {name: found.over_time[name] for name in names}
    growth = times, errors_over_time, found.bands
    shrink = (
        [step.added for step in found.steps],
        np.array([error.value for error in steps]),
        np.array([[error.low for error in steps], [error.high for error in steps]]),
        found.noise_floor,
    )
    units = _units(gap.plant)
    rows = [
        (channel, *(f"{errors[name]:.3g} {units[channel]}" for name in names))
        for channel, errors in found.channels.items()
    ]
    left_out = ", with what was left out" if gap.events else ""
    whole = {**found.everywhere, **({} if gap.events else {"noise_floor": found.noise_floor})}
    everywhere = [three_digits(whole[n]) if n in whole else "–" for n in names]
    rows.append((f"all{left_out} [noise std]", *everywhere))
    return Section(
        f"Free runs through {len(found.windows)} windows "
        + (
            "of recordings that no fit has seen. "
            if gap.held_out
            else f"of the recordings, which were fitted too ({IN_SAMPLE}). "
        )
        + "Each starts from a state that is fitted to its first "
        f"{found.windows.beginning * found.windows.dt:g} s. The "
        "bands are 95 % intervals, by a jackknife over windows that may overlap.",
        [
            draw("Error over the time since the start, by plant", plots.plot_growth, *growth),
            draw("Error at the end of a window, by model", plots.plot_shrink, *shrink, left=0.05),
        ],
        [Table((f"error after {found.horizon_s:g} s", *(_HEADS.get(n, n) for n in names)), rows)],
        "What adding it is worth" if gap.mended else "",
    )


def force(gap: Gap, models: ComparedModels) -> Section:
    """The generalised force that the nominal and the corrected plant leave over."""
    plants = models.plants()
    left = {
        name: missing_force(*plants[name], _without_events(gap), _std(gap)) for name in models.shown
    }
    pictures = [picture for j in _worst_joints(gap) for picture in _force_at(j, gap.plant, left)]
    return Section(
        f"The force that the {models.shown[0]} plant would need at a joint to reproduce the "
        f"recorded motion, averaged over {FORCE_SPAN_S:g} s. A curve over the velocity "
        "is friction, one over the position a spring or the weight, one over the command the "
        "actuator; the lines are medians, half of all values lie within the bands."
        + (" That of the corrected plant should be flat." if gap.mended else ""),
        pictures,
        title="The force that is missing" if gap.mended else "",
        columns=2,
    )


def _without_events(gap: Gap) -> list[Recording]:
    """The recordings, the spans that were left out masked."""
    masked = []
    for recording in gap.recordings:
        states = recording.states.copy()
        for event in gap.events:
            if event.recording == recording.name:
                inside = (recording.time >= event.start_s) & (recording.time <= event.end_s)
                states[inside] = np.nan
        masked.append(replace(recording, states=states))
    return masked


def _force_at(j: int, plant: Plant, left: Mapping[str, MissingForce]) -> Iterator[Picture]:
    """The force left over at a joint, over its position, its velocity and the commands."""
    layout = plant.layout
    joint, (x, f) = layout.joints[j], layout.unit_of(layout.joints[j])
    label = f"missing at {joint} [{f}]"
    q, v = f"{layout.states[2 * j]} [{x}]", f"{layout.states[2 * j + 1]} [{x}/s]"
    along = {q: [part.q[:, j] for part in left.values()]}
    along[v] = [part.v[:, j] for part in left.values()]
    for u, name in enumerate(layout.inputs):
        unit = layout.unit_of(layout.actuator(u))[1]
        along[f"{name} [{unit}]"] = [part.u[:, u] for part in left.values()]
    for name, values in along.items():
        profiles = {
            plant: (x, part.force[:, j])
            for x, (plant, part) in zip(values, left.items(), strict=True)
        }
        says = f"Force {label} over {name}"
        yield draw(says, plots.plot_profile, profiles, (name, label), left=0.18)
    name, part = next(iter(left.items()))
    of = part.q[:, j], part.v[:, j], part.force[:, j], (q, v, f"{label}, {name}")
    says = f"Force {label} over {q} and {v}, {name} plant"
    yield draw(says, plots.plot_force_map, *of, left=0.18, right=0.94, top=0.91)


def when(gap: Gap, models: ComparedModels) -> Section:
    """How far both plants miss each channel, over the time of the recordings."""
    plants = models.plants()
    maps = {name: time_map(*plants[name], gap.recordings, _std(gap)) for name in models.shown}
    names = [recording.name for recording in gap.recordings]
    events = [(names.index(e.recording), e.start_s, e.end_s) for e in gap.events]
    pictures = []
    for x, channel in enumerate(gap.plant.layout.states):
        seen = [found.misfit[x][np.isfinite(found.misfit[x])] for found in maps.values()]
        if not all(map(len, seen)):  # it was not measured
            continue
        most = max(map(float, np.concatenate(seen)))
        for name, found in maps.items():
            label = f"{channel}, {name}"
            of = found.edges, names, found.misfit[x], label, events, most
            room = {"left": 0.2, "right": 0.94, "top": 0.91}
            pictures.append(draw(f"Misfit of {label}", plots.plot_time_map, *of, **room))
    rows = [
        (part.channel, f"{100 * part.share:.0f} %", part.condition)
        for part in gap.where
        if not part.joint
    ]
    return Section(
        "Root mean square residual of windows of one second, whose initial states are fitted, of "
        f"the {' and the '.join(models.shown)} plant. White is noise, grey was not measured."
        + (" The black bars are the spans that were left out." if events else ""),
        pictures,
        [Table(("channel", "share of the misfit", "largest"), rows)] if rows else [],
        columns=2,
    )


def windows(gap: Gap, found: Comparison) -> Section:
    """Some held-out windows: measured, nominal, corrected."""
    assert gap.models is not None
    names = gap.models.shown
    times = found.windows.dt * np.arange(found.windows.y.shape[2])
    units = _units(gap.plant)
    squares = np.nanmean(squares_at_end(scaled_errors(found.windows, found.runs[names[0]])), axis=1)
    order = np.argsort(squares)
    shown = [int(order[round(part * (len(order) - 1))]) for part in _PARTS]
    pictures = []
    for x, state in list(enumerate(gap.plant.layout.states))[0::2]:
        label = f"{state} [{units[state]}]"
        for w in shown:
            recording = gap.compared[found.windows.recording[w]]
            title = f"{recording}, from {found.windows.start_s[w]:.1f} s"
            runs = {name: found.runs[name][w, x] for name in names}
            measured = found.windows.y[w, x]
            of = times, measured, runs, label, title, times[found.windows.beginning]
            pictures.append(draw(f"{state} in {title}", plots.plot_window, *of, top=0.91))
    return Section(
        f"Windows in which the {names[0]} plant is worse than in 90, 50 and 10 % of all. In the "
        "grey part the starts of the free runs were fitted.",
        pictures,
        columns=3,
    )


def experiments(gap: Gap) -> Section:
    """Recordings that would settle what these cannot."""
    return Section(" ".join(gap.experiments))


def candidates(gap: Gap, found: SearchResult) -> Section:
    """The sets of effects that the search has fitted, and what else was looked for."""
    best = found.ranked[0][1]
    rows = [
        (" + ".join(map(str, known.model.effects)) or "nothing", f"{bic - best:+.0f}")
        for known, bic in found.ranked[:_SETS]
    ]
    return Section(
        f"{len(found.ranked)} sets of effects were fitted; these are the best, by their BIC less "
        f"that of the best one.",
        tables=[Table(("effects", "BIC"), rows)],
        folded=True,
    )


def recordings(gap: Gap) -> Section:
    """The recordings, what they were used for, and what was left out of them."""
    rows = []
    for recording in gap.recordings:
        name = recording.name
        uses = {"fitted": name in gap.train, "held out": name in gap.held_out}
        spans = [f"{e.start_s:.1f} to {e.end_s:.1f} s" for e in gap.events if e.recording == name]
        rows.append(
            (
                name,
                f"{len(recording) * recording.dt:.1f} s at {1.0 / recording.dt:.4g} Hz",
                ", ".join(use for use, true in uses.items() if true),
                ", ".join(spans) or "–",
                " ".join(recording.remarks) or "–",
            )
        )
    tables = [Table(("recording", "length", "used as", "left out", "remarks"), rows)]
    if gap.comparison is not None:
        units, std = _units(gap.plant), _std(gap)
        seen = np.any(gap.comparison.windows.measured, axis=(0, 2))
        noise = [
            (name, f"{std[x]:.3g} {units[name]}" if seen[x] else "not measured")
            for x, name in enumerate(gap.plant.layout.states)
        ]
        tables.append(Table(("state", "noise std"), noise))
    return Section(tables=tables, folded=True)


def _std(gap: Gap) -> Float[np.ndarray, " X"]:
    """Noise of each state's measurement, in its unit."""
    assert gap.comparison is not None
    return gap.comparison.windows.std


def _worst_joints(gap: Gap) -> list[int]:
    """The joints whose channels are missed most, the worst first."""
    layout = gap.plant.layout
    share = dict.fromkeys(range(len(layout.joints)), 0.0)
    for part in gap.where:
        share[layout.joint_of(part.channel)] += part.share
    for named in gap.named:  # wherever its consequences are
        share[layout.joint_of(named.target)] += 1.0
    return sorted(share, key=lambda j: -share[j])[:_JOINTS]


def _kind(gap: Gap) -> str:
    return "held-out" if gap.held_out else "fitted"


def _units(plant: Plant) -> dict[str, str]:
    return dict(zip(plant.layout.states, plant.layout.units, strict=True))
