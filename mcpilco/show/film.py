"""The trials of a run one after another, as one Rerun recording; of two runs, one over the other.

The timeline is that of a single recording, `sim_time`, on which each trial begins where the one
before has ended, after a pause.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr

from mcpilco.logbook import History, PastTrial, RunFolder, read_search, read_task, read_trial
from mcpilco.show import entities
from mcpilco.show.blueprint import ABOUT, LEARNING, SEARCH, build_blueprint
from mcpilco.show.recording import extent_of, log_note, new_recording
from mcpilco.show.scene import Scene
from mcpilco.typing import InputError, RunFolderError

_PAUSE_S = 0.5
"""between two trials, to see how the first one ended [s]"""


@dataclass(frozen=True)
class Reel:
    """A run to be shown."""

    history: History
    """its trials"""
    scene: Scene | None = None
    """how to draw a state in 3D; None leaves the curves alone"""


class Film:
    """Trials that follow one another in a recording; it may be watched while it grows."""

    def __init__(self, rec: rr.RecordingStream, reels: Sequence[Reel], live: bool = False) -> None:
        """An empty film.

        It is of one run, or of two of one system to be overlaid; `live` ones follow trials to come.

        Raises:
            InputError: the runs are not of one system.
        """
        self.rec = rec
        self.end_s = 0.0
        """when the last trial ends [s]"""
        self._reels = reels
        self._live = live
        self._start_s, self._first = 0.0, 0
        alone = (entities.Colors(observed=None, estimated=None),)
        self._colors: Sequence[entities.Colors] = alone if len(reels) == 1 else entities.OVERLAID
        _require_one_system(reels)

    def add(self, trials: Sequence[PastTrial | None]) -> None:
        """Show a trial after those shown so far."""
        shown = [trial for trial in trials if trial is not None]
        dt = shown[0].rollout.dt
        steps = max(len(trial.rollout) for trial in shown)
        for i, trial in enumerate(trials):
            if trial is not None:
                self._add(i, trial)
        self._note(_notes(self._reels, trials))
        pause = max(round(_PAUSE_S / dt), 2)
        self.end_s = self._start_s + dt * steps
        self._start_s += dt * (steps + pause)
        self._first += steps + pause

    def show_search(self, trial: int, costs: Sequence[float]) -> None:
        """Show how the policy search of a trial goes: the cost after each of its steps."""
        self.rec.log(
            SEARCH, rr.BarChart(np.nan_to_num(costs), color=self._colors[0].model), static=True
        )
        self._note(
            f"### trial {trial}: searching the policy\n\n{len(costs)} steps, the models expect a "
            f"cost of **{costs[-1]:.2f}**\n\n{entities.FILM_IN_WORDS}"
        )

    def frame(self, trials: Sequence[PastTrial]) -> None:
        """Lay the views out, so that the camera sees all of these trials."""
        self.rec.send_blueprint(self.blueprint(trials), make_active=True)

    def blueprint(self, trials: Sequence[PastTrial]) -> rr.blueprint.Blueprint:
        """The layout; the camera sees all of these trials."""
        scene = self._reels[0].scene
        extents = [extent_of(scene, trial.rollout) for trial in trials]
        points = [extent for extent in extents if extent is not None]
        extent = np.concatenate(points) if points else None
        task = self._reels[0].history.task
        return build_blueprint(task, extent, film=True, live=self._live)

    def _add(self, i: int, trial: PastTrial) -> None:
        reel, rollout = self._reels[i], trial.rollout
        track = entities.Track(
            self.rec,
            rollout.dt,
            start_s=self._start_s,
            first=self._first,
            colors=self._colors[i],
            gap=True,
            group="" if len(self._reels) == 1 else "ab"[i],
        )
        if reel.scene is not None:
            entities.log_scene(track, reel.scene, rollout.shown_states)
            if trial.prediction is not None:
                entities.log_particles(track, reel.scene, trial.prediction)
        entities.log_curves(track, reel.history.task, rollout, trial.prediction, trial.costs)
        if trial.number:
            predicted = "predicted", trial.predicted_cost, track.colors.model
            for name, cost, color in (predicted, ("system", trial.real_cost, track.colors.system)):
                level = np.full(len(rollout) + 1, cost)
                entities.log_line(track, track.under(LEARNING, name), 0, level, color)

    def _note(self, text: str) -> None:
        if self._live:
            note = rr.TextDocument(text, media_type="text/markdown")
            self.rec.log(ABOUT, note, static=True)
        else:
            log_note(self.rec, text, self._start_s, self._first)


def write_run_film(path: Path, reels: Sequence[Reel], trial: int | None = None) -> float:
    """When the film ends [s]; equal runs make equal films.

    The reels are one run, or two of one system to be overlaid; `trial` shows that one alone.

    Raises:
        InputError: the runs are not of one system, or none of them has the trial.
        RunFolderError: the file cannot be written.
    """
    by_number = [{past.number: past for past in reel.history.trials} for reel in reels]
    have = sorted(set().union(*by_number))
    numbers = [number for number in have if trial in (None, number)]
    if not numbers:
        raise InputError(f"--trial must be one of {', '.join(map(str, have))}, got {trial}.")
    shown = [[trials.get(number) for trials in by_number] for number in numbers]
    present = [past for row in shown for past in row if past is not None]
    arrays = (a for past in present for a in (past.rollout.observations, past.rollout.inputs))
    with new_recording(path, "film", arrays) as rec:
        film = Film(rec, reels)
        rec.send_blueprint(film.blueprint(present))
        rec.send_recording_name(" and ".join(_name(reel) for reel in reels))
        for row in shown:
            film.add(row)
    return film.end_s


def _notes(reels: Sequence[Reel], trials: Sequence[PastTrial | None]) -> str:
    number = next(trial.number for trial in trials if trial is not None)
    title = f"### trial {number}" if number else "### exploration"
    lines = [
        (f"{_name(reel)}: " if len(reels) > 1 else "") + _told(trial)
        for reel, trial in zip(reels, trials, strict=True)
    ]
    words = entities.FILM_IN_WORDS if len(reels) == 1 else entities.OVERLAID_IN_WORDS
    return "\n\n".join([title, *lines, words])


def _told(trial: PastTrial | None) -> str:
    if trial is None:
        return "no such trial"
    if not trial.number:
        return f"{len(trial.rollout) * trial.rollout.dt:g} s"
    success = {True: ", a **success**", False: ", no success", None: ""}[trial.success]
    return (
        f"after {trial.experience_s:g} s of experience: cost predicted "
        f"**{trial.predicted_cost:.2f}**, real **{trial.real_cost:.2f}**{success}"
    )


def _name(reel: Reel) -> str:
    return reel.history.run.path.resolve().name


def _require_one_system(reels: Sequence[Reel]) -> None:
    first = reels[0].history.task
    for reel in reels[1:]:
        other = reel.history.task
        for entry in ("state_names", "input_names"):
            if getattr(first, entry) != getattr(other, entry):
                raise InputError(
                    "Two runs can be overlaid where they are of one system; the first has the "
                    f"{entry} {', '.join(getattr(first, entry))}, "
                    f"the second {', '.join(getattr(other, entry))}."
                )


class Follower:
    """Adds to a film what has come to a run folder since the last look.

    It only reads: the training neither waits for it nor knows of it.
    """

    def __init__(self, run: RunFolder, scene: Scene | None, rec: rr.RecordingStream) -> None:
        self.run = run
        self._scene = scene
        self._rec = rec
        self._film: Film | None = None
        self._seen: list[PastTrial] = []
        self._search_bytes = 0

    @property
    def finished(self) -> bool:
        """Whether the run has ended and all of it was shown."""
        return self.run.summary() is not None and not self._news()

    def look(self) -> None:
        """Show each rollout that is new, and how the present search goes.

        Raises:
            RunFolderError: a file is damaged.
        """
        film = self._begin()
        if film is None:
            return
        task = read_task(self.run)
        rows = {row["trial"]: row for row in self.run.metrics()}
        for number in self._news():
            trial = read_trial(self.run, task, number, rows.get(number, {}))
            self._seen.append(trial)
            film.frame(self._seen)
            film.add([trial])
        self._show_search(film)

    def _begin(self) -> Film | None:
        """The film, from the moment on from which the folder tells what is learned."""
        if self._film is None and self._news():
            with contextlib.suppress(RunFolderError):
                history = History(self.run, read_task(self.run), (), ())
                self._film = Film(self._rec, [Reel(history, self._scene)], live=True)
        return self._film

    def _news(self) -> list[int]:
        """Numbers of the rollouts that are whole on disk and were not shown."""
        explored = [0] if self.run.arrays_path(0, "rollout").exists() else []
        seen = {trial.number for trial in self._seen}
        return [n for n in explored + self.run.finished_trials() if n not in seen]

    def _show_search(self, film: Film) -> None:
        """The search of the trial that comes next, where there is more of it than before."""
        path = self.run.policy_steps_path
        size = path.stat().st_size if path.exists() else 0
        if size == self._search_bytes:
            return
        self._search_bytes = size
        trial, costs = max(read_search(self.run).items(), default=(0, []))
        if trial > self._seen[-1].number:
            film.show_search(trial, costs)
