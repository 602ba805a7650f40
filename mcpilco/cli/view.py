"""`mcpilco view`: look at a run's rollouts beside the particles predicted for them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from mcpilco.cli.options import RunPath, optional
from mcpilco.cli.system import choose_trial


@dataclass(frozen=True)
class View:
    """Look at the rollouts of a run in the Rerun viewer."""

    run: RunPath
    """run folder"""
    trial: Annotated[int | None, optional("INT", "the last")] = None
    """whose rollout; 0 is the exploration"""
    web: bool = False
    """look with a browser, until Ctrl-C"""
    screenshot: Annotated[Path | None, optional("FILE", "none")] = None
    """write a picture to this file instead; needs no display"""
    at: Annotated[float | None, optional("FLOAT", "the end")] = None
    """instant of the picture [s]"""

    def __call__(self) -> int:
        """Show, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        from mcpilco.run_folder import RunFolder
        from mcpilco.visual.viewer import open_viewer, screenshot

        run = RunFolder.open(self.run)
        trial = _recorded(run, self.trial)
        path = run.recording_path(trial)
        if self.screenshot is None:
            open_viewer([path], web=self.web)
        else:
            at = _duration(run, trial) if self.at is None else self.at
            print(screenshot(path, self.screenshot, at))
        return 0


def _recorded(run: Any, trial: int | None) -> int:
    """The trial asked for, or the last that has a recording."""
    names = (path.stem for path in (run.path / "rollouts").glob("*.rrd"))
    trials = sorted(int(name) for name in names if name.isdecimal())
    none = f"{run.path} holds no recording yet; train until the first rollout ends."
    return choose_trial(trials, trial, none)


def _duration(run: Any, trial: int) -> float:
    """Length of a rollout [s]."""
    arrays = run.read_arrays(trial, "rollout")
    return float(arrays["dt"]) * len(arrays["inputs"])
