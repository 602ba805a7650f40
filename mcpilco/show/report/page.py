"""The page of a run: everything that its folder tells, in one HTML file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.agent import find
from mcpilco.data import title_of
from mcpilco.files import require_own
from mcpilco.logbook import History, PastTrial, RunFolder, measures_in, read_history, read_search
from mcpilco.show.plots import training as plots
from mcpilco.show.plots.rollouts import plot_costs, plot_input, plot_state
from mcpilco.show.report import learned as models
from mcpilco.show.report.document import Document, Section, Table, draw, made, write_document
from mcpilco.sweep import FACTORS, Direction
from mcpilco.typing import InputError, RunFolderError

_TABLE_LEVELS = (0.5, 0.9, 0.95, 0.99)


def write_report(run: RunFolder, out: Path | None = None) -> Path:
    """The path of the page written; it holds its pictures and needs no other file.

    What cannot be read of the run is named in the page, which is `report.html` in the run folder by
    default.

    Raises:
        RunFolderError: nothing can be read, or the page cannot be written.
        InputError: matplotlib or jinja2 is missing.
    """
    history = read_history(run)
    if out is None:
        out = run.path / "report.html"
        require_own(run.path, out)
    return write_document(out, page_of(history))


def page_of(history: History) -> Document:
    """The content of the page of a run."""
    config = history.run.config
    algo, preset = config.get("algo", "mcpilco"), config["preset"]
    setting = preset if algo == "mcpilco" else f"{algo} {preset}"
    return Document(
        title=f"{config['env']}, {setting}, seed {config['seed']}",
        about=history.run.path.resolve().name,
        tiles=_tiles(history),
        sections=_sections(history),
        cautions=failures(history),
    )


def _sections(history: History) -> Iterator[Section]:
    """All sections; one that cannot be made says why."""
    learned = history.learned
    if learned:
        yield made("Learning", learning, history)
        last = learned[-1]
        yield made("Last trial", rollout, history, last, False)
        if history.foreseen:
            yield made("How far the predictions hold", errors, history)
            yield made("Calibration", calibration, history)
            yield made("Policy", policy, history)
        if found := models.held_directions(history):
            yield made("Where the policy holds", held, history, found)
        yield made("Policy search", search, history)
        yield made("Timings", timings, history)
    for trial in history.trials:
        if not learned or trial is not learned[-1]:
            title, fold = f"Trial {trial.number}", bool(learned)
            yield made(title, rollout, history, trial, fold)
    yield made("Configuration", configuration, history)


def _tiles(history: History) -> list[tuple[str, str]]:
    learned = history.learned
    if not learned:
        return [("trials", "none yet")]
    last = learned[-1]
    won = [trial for trial in learned if trial.success]
    tiles = [("trials", f"{len(learned)} of {history.run.config['trials']}")]
    if any(trial.success is not None for trial in learned):
        first = f"after {won[0].experience_s:g} s" if won else "not yet"
        tiles += [("first success", first), ("successes", f"{len(won)} of {len(learned)}")]
    if history.foreseen:
        tiles.append(("last cost, predicted", f"{last.predicted_cost:.2f}"))
    tiles.append(("last cost, real", f"{last.real_cost:.2f}"))
    tiles.append(("time of the trials", f"{sum(t.row['wall_s'] for t in learned):.0f} s"))
    return tiles


def learning(history: History) -> Section:
    """The learning curve, and a table of the trials."""
    measured = [
        name
        for name in ("success", *measures_in(history.learned[-1].row if history.learned else ()))
        if any(trial.row.get(name) is not None for trial in history.learned)
    ]
    header = ("trial", "experience [s]", "predicted cost", "real cost")
    rows = [
        (
            str(trial.number),
            f"{trial.experience_s:.1f}",
            _cell(None)
            if trial.prediction is None
            else f"{trial.predicted_cost:.2f} ± {trial.predicted_cost_std:.2f}",
            f"{trial.real_cost:.2f}",
            *(_cell(trial.row.get(name)) for name in measured),
        )
        for trial in history.learned
    ]
    return Section(
        "The cost of an episode after so much experience: what the models expected of each policy "
        "before it was tried, with the standard deviation over particles, and what came. "
        "A filled dot is a success.",
        [draw("Cost of each trial over experience", plots.plot_learning, history.learned)],
        [Table((*header, *map(title_of, measured)), rows)],
    )


def search(history: History) -> Section:
    """How the policy search of each trial went; of an agent without a model, its episodes."""
    costs, labels = read_search(history.run), {}
    title, kind, says = "Policy search", "steps", "Predicted cost over steps"
    text = (
        "The cost that the models expect after each step of the optimiser. Where a search tried "
        "several starts, they follow one another."
    )
    if not history.foreseen:
        title, kind, says = "Episodes", "episodes", "Cost of each episode"
        text = "What each episode cost that was learned from, with the noise of exploration."
        labels = {"xlabel": "episode of the trial", "ylabel": "its cost [-]"}
    pictures = [draw(says, lambda ax: plots.plot_search(costs, ax).set(**labels))] if costs else []
    rows = [(str(trial), str(len(values))) for trial, values in costs.items()]
    return Section(text, pictures, [Table(("trial", kind), rows)], title)


def rollout(history: History, trial: PastTrial, folded: bool) -> Section:
    """One rollout over time, beside what was predicted for it.

    Reference: thesis figures 5.3 and 5.4.
    """
    task, real, expected = history.task, trial.rollout, trial.prediction
    pictures = [
        draw(f"{name} over time", plot, real, expected, task, i)
        for plot, names in ((plot_state, task.state_names), (plot_input, task.input_names))
        for i, name in enumerate(names)
    ]
    if trial.costs is not None or expected is not None:
        pictures.append(draw("cost over time", plot_costs, trial.costs, expected, real.dt))
    if not trial.number:
        title = "Exploration: the rollout before the first trial"
    else:
        verdict = {True: ": success", False: ": no success", None: ""}[trial.success]
        title = f"Trial {trial.number}, after {trial.experience_s:g} s{verdict}"
    return Section(pictures=pictures, title=title, key=True, folded=folded)


def errors(history: History) -> Section:
    """How far the particles are from the system, along each trial's rollout.

    Reference: thesis figure 5.5.
    """
    task = history.task
    found = {
        trial.number: models.rollout_errors(trial.rollout.shown_states, trial.prediction)
        for trial in history.learned
        if trial.prediction is not None
    }
    pictures = []
    for i, name in enumerate(task.state_names):
        along = {number: values[:, i] for number, values in found.items()}
        of = along, task.dt, name, task.state_units[i]
        pictures.append(draw(f"Prediction error of {name} over time", plots.plot_errors, *of))
    return Section(
        "The distance between the system and the particles predicted for it, root mean square over "
        "the particles. The darker, the later the trial.",
        pictures,
    )


def calibration(history: History) -> Section:
    """Whether the predicted spread covers the truth."""
    by_trial = {trial.number: models.one_step(history, trial) for trial in history.learned}
    steps = reduce(add, by_trial.values())
    shares = dict(zip(steps.names, steps.coverage(models.LEVELS).T, strict=True))
    along = np.mean(
        [
            models.rollout_coverage(trial.rollout.shown_states, trial.prediction, models.LEVELS)
            for trial in history.learned
            if trial.prediction is not None
        ],
        axis=0,
    )
    rollouts = dict(zip(history.task.state_names, along.T, strict=True))
    count = len(steps.errors)
    pictures = [
        draw("Coverage one step ahead", plots.plot_coverage, models.LEVELS, shares, count),
        draw("Coverage along rollouts", plots.plot_coverage, models.LEVELS, rollouts, None),
    ]
    return Section(
        "How often the truth lies in the interval that the models name, over the interval's level: "
        "below the diagonal they are too sure, above it too cautious. First, one step ahead: each "
        f"trial's {count // len(history.learned)} steps, which its models had not seen, all trials "
        "together; the band is what chance leaves to models that are right, were the steps "
        "independent. Second, along the rollouts: how often the particles surround the system; the "
        "steps of a rollout go wrong together, so few trials say little. In the table: root mean "
        "squares, and the shares one step ahead.",
        pictures,
        [_coverage_table(by_trial)],
    )


def _coverage_table(by_trial: Mapping[int, models.OneStep]) -> Table:
    """A row for each trial and predicted state: error, spread, shares covered."""
    within = (f"within {level:.0%}" for level in _TABLE_LEVELS)
    header = ("trial", "change of", "error", "predicted spread", *within)
    rows = []
    for number, steps in by_trial.items():
        rms, spread = (np.sqrt(np.square(v).mean(axis=0)) for v in (steps.errors, steps.std))
        shares = steps.coverage(np.array(_TABLE_LEVELS)).T
        for i, (name, unit) in enumerate(zip(steps.names, steps.units, strict=True)):
            sizes = (f"{rms[i]:.3g} {unit}", f"{spread[i]:.3g} {unit}")
            rows.append((str(number), name, *sizes, *(f"{share:.0%}" for share in shares[i])))
    return Table(header, rows)


def policy(history: History) -> Section:
    """The inputs of the last policy over the states."""
    trial = history.learned[-1]
    pictures = [
        draw(f"{found.labels[2]} over {found.labels[0]}", plots.plot_policy, found)
        for found in models.policy_maps(history, trial)
    ]
    return Section(
        f"What the policy of trial {trial.number} answers over two states, the others as at the "
        "end of its rollout. The line is the rollout's way, from the open dot to the filled one.",
        pictures,
    )


def held(history: History, found: Sequence[Direction]) -> Section:
    """The success of the last policy where one number of the plant is another."""
    rows = [
        (f"{d.name} = {d.value:.3g} {d.unit}", *(f"{share:.0%}" for share in d.success))
        for d in found
    ]
    return Section(
        f"Success of the policy of trial {history.learned[-1].number} in fresh rollouts, where the "
        "env simulates its plant with one number times a factor, and the others as they are.",
        [draw("Success over the numbers of the plant", plots.plot_directions, found)],
        [Table(("number", *(f"x {factor:g}" for factor in FACTORS)), rows)],
    )


def timings(history: History) -> Section:
    """Time that each trial took."""
    numbers = [trial.number for trial in history.learned]
    wall, cpu = ([trial.row[key] for trial in history.learned] for key in ("wall_s", "cpu_s"))
    times = zip((*numbers, "all"), (*wall, sum(wall)), (*cpu, sum(cpu)), strict=True)
    rows = [(str(number), f"{clock:.1f}", f"{used:.1f}") for number, clock, used in times]
    return Section(
        "The first trial also loads the compiled loops, or compiles them.",
        [draw("Time of each trial", plots.plot_times, numbers, wall, cpu)],
        [Table(("trial", "clock [s]", "processor [s]"), rows)],
    )


def configuration(history: History) -> Section:
    """All numbers of the agent; what differs from the preset is marked."""
    config = history.run.config
    try:
        preset = find(config.get("algo", "mcpilco")).presets.get(config["preset"])
    except InputError:  # an algorithm that is not known here
        preset = None
    numbers = {} if preset is None else asdict(preset.config_for(config["env"]))
    usual = dict(_entries(numbers))
    rows = [
        (name, value, "" if usual.get(name, value) == value else usual[name])
        for name, value in _entries(config["config"])
    ]
    keys = ("env", "env_kwargs", "algo", "preset", "seed", "trials")
    about = [(key, _text(config[key])) for key in keys if key in config]
    tables = [
        Table(("run", ""), about),
        Table(("entry", "value", "the preset's, where it differs"), rows),
        Table(("package", "version"), [(k, str(v)) for k, v in config["versions"].items()]),
    ]
    return Section(tables=tables, folded=True)


def _entries(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted names and values of all entries."""
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _entries(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _text(value)


def _text(value: object) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def _cell(value: float | bool | None) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.2f}"


def failures(history: History) -> list[str]:
    """A sentence for each thing that went wrong, or may have."""
    said = list(history.problems)
    learned, asked = history.learned, history.run.config["trials"]
    try:
        finished = history.run.summary() is not None
    except RunFolderError as error:
        said.append(str(error))
        finished = True
    if not finished:
        said.append(
            f"The run has not ended: {len(learned)} of {asked} trials are there. "
            "It was interrupted, or goes on."
        )
    elif not learned:
        said.append("No trial was finished.")
    lost = [str(trial.number) for trial in learned if trial.success is False]
    if lost:
        said.append(f"No success in trial {', '.join(lost)}.")
    crossed = [str(trial.number) for trial in learned if trial.row.get("limits_crossed")]
    if crossed:
        said.append(f"A limit of the states was crossed in trial {', '.join(crossed)}.")
    for trial in learned:
        if trial.row.get("failure"):
            said.append(f"Trial {trial.number}: {trial.row['failure']}")
        spread = trial.predicted_cost_std
        if trial.real_cost > trial.predicted_cost + 3 * spread:
            said.append(
                f"Trial {trial.number} cost {trial.real_cost:.2f}, more than three standard "
                f"deviations above the {trial.predicted_cost:.2f} ± {spread:.2f} that its models "
                "expected."
            )
    return said
