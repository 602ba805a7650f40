"""`mcpilco demo`: two trials on the cart-pole, and a picture of what came of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from mcpilco.cli.options import Command, optional, without
from mcpilco.cli.train import Train
from mcpilco.cli.view import View

if TYPE_CHECKING:
    from mcpilco.logbook import RunFolder

_TRIALS = 2


@dataclass(frozen=True, kw_only=True)
class Demo(Command):
    """Learn two policies of the cart-pole, and show the last one; takes about a minute."""

    out: Annotated[Path | None, optional("FOLDER", "that of `mcpilco train`")] = None
    """run folder to make; the picture goes there too"""
    seed: int = 1
    """of everything random; 1 is one of the two in three whose second policy swings the pole up"""
    no_view: bool = False
    """do not open the viewer at the end, which opens where there is a display"""

    def __call__(self) -> int:
        train = Train(seed=self.seed, trials=_TRIALS, out=self.out)
        folder = train.folder()
        replace(train, out=folder)()

        from mcpilco.logbook import RunFolder
        from mcpilco.show import has_display

        run = RunFolder.open(folder)
        print(f"Recording:  {run.recording_path(_TRIALS)}")
        with without("the picture"):
            print(f"Picture:    {_draw(run)}")
        return View(folder)() if has_display() and not self.no_view else 0


def _draw(run: RunFolder) -> Path:
    """The picture written into the run folder: the cost of each trial, and the last rollout."""
    from mcpilco.logbook import read_history
    from mcpilco.show import plot_input, plot_learning, plot_states
    from mcpilco.show.plots import new_axes, write_picture

    history = read_history(run)
    last, task = history.learned[-1], history.task
    first, *states, force = new_axes(len(task.state_names) + 2)
    plot_learning(history.learned, first)
    plot_states(last.rollout, last.prediction, task, states)
    plot_input(last.rollout, last.prediction, task, 0, force)
    return write_picture(run.path / "demo.png", first)
