"""Watching a run while it learns: what is new in its folder, streamed to a viewer."""

from __future__ import annotations

import contextlib

import rerun as rr

from mcpilco.logbook import History, PastTrial, RunFolder, read_search, read_task, read_trial
from mcpilco.show.film import Film, Reel
from mcpilco.show.scene import Scene
from mcpilco.typing import RunFolderError


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
