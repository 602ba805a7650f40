"""`mcpilco view`: look at a run's rollouts beside the particles predicted for them, or at a gap."""

from __future__ import annotations

import contextlib
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from mcpilco.cli.options import Command, RunPath, Trust, optional, register, warn
from mcpilco.typing import InputError, McPilcoError

_FIRST_WINDOW_S = 1.0
"""about the end of the first window of a gap's recording [s]"""
_LOOK_S = 1.0
"""between two looks at a run that is being written [s]"""


FILMS = ("gap.rrd", "crossing.rrd")
"""recordings in the folders of other commands"""


@dataclass(frozen=True)
class View(Command):
    """Look at the rollouts of a run in the Rerun viewer, one trial after another.

    Or at what `mcpilco gap` has found, or what came of `mcpilco cross`.
    """

    run: RunPath
    """run folder, folder of `mcpilco gap` or `mcpilco cross`, or .rrd file"""
    other: Annotated[
        tyro.conf.Positional[Path | None],
        tyro.conf.arg(metavar="[RUN_B]", help_behavior_hint="(default: none)"),
    ] = None
    """another run of the same system, to lay over the first"""
    trial: Annotated[int | None, optional("INT", "all, one after another")] = None
    """this rollout alone; 0 is the exploration"""
    web: bool = False
    """look with a browser, until Ctrl-C"""
    live: bool = False
    """follow a run that is being trained"""
    screenshot: Annotated[Path | None, optional("FILE", "none")] = None
    """write a picture to this file instead; needs no display"""
    video: Annotated[Path | None, optional("FILE", "none")] = None
    """write the last trial's rollout, or that of `--trial`, to this .gif or .mp4 file instead"""
    at: Annotated[float | None, optional("FLOAT", "the end")] = None
    """instant of the picture [s]"""
    trust: Trust = ()
    """modules of your own that the run names; they are imported"""

    def __call__(self) -> int:
        register(trusted=self.trust)
        from mcpilco.agent import choose_trial
        from mcpilco.logbook import RunFolder

        for film in (self.run, *(self.run / name for name in FILMS)):
            if film.suffix == ".rrd" and film.is_file():
                if self.other or self.video or self.live or self.trial is not None:
                    raise InputError(
                        f"{film} is no run: it takes no RUN_B, --trial, --video or --live."
                    )
                self._show(film, lambda: _FIRST_WINDOW_S)
                return 0
        runs = [RunFolder.open(path) for path in (self.run, self.other) if path is not None]
        if self.video is not None:
            if len(runs) > 1 or self.live or self.web or self.screenshot is not None:
                raise InputError("--video takes one run, and no --live, --web or --screenshot.")
            print(_write_video(self.video, runs[0], self.trial))
            return 0
        if self.live:
            self._follow(runs)
            return 0
        trials = [_recorded(run) for run in runs]
        with tempfile.TemporaryDirectory() as folder:
            film = Path(folder) / "film.rrd"
            if len(runs) == 1 and (self.trial is not None or len(trials[0]) == 1):
                trial = choose_trial(trials[0], self.trial, "")
                self._show(runs[0].recording_path(trial), lambda: _duration(runs[0], trial))
            else:
                end_s = _write_film(film, runs, self.trial)
                self._show(film, lambda: end_s)
        return 0

    def _show(self, recording: Path, end_s: Any) -> None:
        from mcpilco.show import open_viewer, screenshot

        if self.screenshot is None:
            open_viewer([recording], web=self.web, tell=_tell)
        else:
            at = end_s() if self.at is None else self.at
            print(screenshot(recording, self.screenshot, at))

    def _follow(self, runs: list[Any]) -> None:
        """Show what a run learns, until the viewer is closed."""
        if len(runs) > 1 or self.screenshot is not None or self.trial is not None:
            raise InputError("--live follows one run: it takes no RUN_B, --trial or --screenshot.")
        import rerun as rr

        from mcpilco.show import Follower, live_viewer

        with (
            live_viewer(web=self.web, tell=_tell) as viewer,
            contextlib.suppress(KeyboardInterrupt),
        ):
            rec = rr.RecordingStream("mcpilco", send_properties=False)
            rec.connect_grpc(viewer.url)
            rec.send_recording_name(runs[0].path.resolve().name)
            follower = Follower(runs[0], _scene(runs[0]), rec)
            try:
                while not viewer.closed and not follower.finished:
                    follower.look()
                    time.sleep(_LOOK_S)
                viewer.wait()
            finally:
                rec.disconnect()


def _tell(address: str) -> None:
    print(f"Look at it: {address} (Ctrl-C ends it)", flush=True)


def _write_film(path: Path, runs: list[Any], trial: int | None) -> float:
    """A film of the runs; returns its end [s]."""
    from mcpilco.logbook import read_history
    from mcpilco.show import Reel, write_run_film

    reels = []
    for run in runs:
        history = read_history(run)
        warn(*history.problems, about="mcpilco: left out")
        reels.append(Reel(history, _scene(run)))
    return write_run_film(path, reels, trial)


def _write_video(path: Path, run: Any, asked: int | None) -> Path:
    """The path of a video of a trial: its policy acts again, from the trial's seed of the env."""
    from gymnasium.wrappers import RenderCollection

    from mcpilco.agent import Streams, agent_of, finished_trial, open_run_env, run_episode
    from mcpilco.show import write_video

    trial = finished_trial(run, asked)
    with contextlib.closing(
        open_run_env(run, {**run.config["env_kwargs"], "render_mode": "rgb_array"})
    ) as env:
        if env.render_mode != "rgb_array":
            raise InputError(f"{run.config['env']} draws no pictures; use --screenshot.")
        filmed = RenderCollection(env)
        agent = agent_of(run, trial, filmed)
        seed = Streams(run.config["seed"]).reset(trial)
        run_episode(agent.env, agent.controller(), agent.horizon, agent.task.dt, seed)
        frames: Any = filmed.render()
        return write_video(path, frames, agent.task.dt)


def _scene(run: Any) -> Any:
    """How the run's env draws its states; None, with a note, where it cannot be made here."""
    from mcpilco.agent import open_run_env

    try:
        with contextlib.closing(open_run_env(run)) as env:
            return getattr(env.unwrapped, "scene", None)
    except McPilcoError as error:
        warn(f"without the scene: {' '.join(str(error).split())}")
        return None


def _recorded(run: Any) -> list[int]:
    from mcpilco.agent import choose_trial

    names = (path.stem for path in (run.path / "rollouts").glob("*.rrd"))
    trials = sorted(int(name) for name in names if name.isdecimal())
    choose_trial(
        trials, None, f"{run.path} holds no recording yet; train until the first rollout ends."
    )
    return trials


def _duration(run: Any, trial: int) -> float:
    arrays = run.read_arrays(trial, "rollout")
    return float(arrays["dt"]) * len(arrays["inputs"])
