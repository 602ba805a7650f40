"""`mcpilco cross`: from recordings of a system to a policy that was trained in simulation."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli.gap import Gap
from mcpilco.cli.model import SuitablePreset
from mcpilco.cli.options import Algo, optional
from mcpilco.cli.pairs import EnvKeywords, keywords
from mcpilco.cli.record import Record
from mcpilco.cli.system import agent_of, open_env, use_one_thread
from mcpilco.cli.train import Train
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError, McPilcoError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.crossing import Crossing, Place

TRIALS = 4
"""of an algorithm that learns by trials"""
PHYSICS_MODEL = "physics+rbf"
"""the equations of the simulation, and what they leave"""
LEGS = ("nominal", "corrected")
"""the policies that are compared, by the simulation that they are trained in"""


@dataclass(frozen=True)
class Cross:
    """Record a system, correct its simulation, train in both, and try both policies on it.

    Each stage is kept in the folder; the same command goes on where it was stopped.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder of everything: recordings, gap, both trainings, what came of them, report.html"""
    env: str = CART_POLE
    """Gymnasium id of the system; `module:Id` imports the module first"""
    env_kwargs: EnvKeywords = ()
    """keywords of the system's env; of a JSON file the content"""
    sim: str = CART_POLE
    """id of the env that simulates it; its plant is corrected"""
    sim_kwargs: EnvKeywords = ()
    """keywords of the simulation, such as other values of nominal parameters"""
    seconds: float = 60.0
    """of recordings of the system [s]"""
    rollouts: int = 6
    """recordings, of equal length"""
    dt: Annotated[float | None, optional("FLOAT", "the env's")] = None
    """sampling time of the recordings [s], for envs with the keyword `dt`"""
    uncertainty: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STD|NAME=STD...")] = ("0.01",)
    """prior std of nominal parameters, as in `mcpilco gap`"""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...|all")] = ()
    """parameters of which nothing is known beforehand"""
    algo: Algo = "mcpilco"
    """what trains in simulation, where experience costs nothing"""
    preset: SuitablePreset = None
    """of the algorithm"""
    trials: Annotated[
        int | None, optional("INT", f"{TRIALS}, of sac, tqc and ppo the preset's")
    ] = None
    """policies to learn in each simulation; the best there goes to the system"""
    episodes: int = 100
    """fresh ones, that a policy is judged by in simulation and on the system"""
    seed: int = 0
    """of everything random; equal seeds give equal results"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        """Go through the stages that are missing, and return the exit code.

        Raises:
            McPilcoError: a wrong input; the sentence says which.
        """
        self._check()
        use_one_thread()
        self._begin()
        for number, (name, stage) in enumerate(self._stages(), start=1):
            if not self.quiet:
                print(f"\n{number} of 5: {name}", flush=True)
            code = stage()
            if code:
                return code
        return 0

    def _stages(self) -> Iterator[tuple[str, Any]]:
        yield "recordings of the system", self._record
        yield "what the simulation lacks", self._find
        for leg in LEGS:
            yield (
                f"training in the {leg} simulation, and the policy on the system",
                (lambda leg=leg: self._train(leg) or self._try(leg)),
            )
        yield "the story", self._tell

    # Stages ---------------------------------------------------------------------------------------

    def _record(self) -> int:
        """One rollout a file, so that what a system has done is never asked of it again."""
        for k in range(self.rollouts):
            seed = self.rollouts * self.seed + k
            if (self._recordings / f"excitation-seed{seed}-00.csv").exists():
                continue
            code = Record(
                out=self._recordings,
                env=self.env,
                env_kwargs=self.env_kwargs,
                seconds=self.seconds / self.rollouts,
                rollouts=1,
                dt=self.dt,
                seed=seed,
                quiet=True,
            )()
            if code:
                return code
        return 0

    def _find(self) -> int:
        if self._verdict is None:
            Gap(
                recordings=tuple(sorted(self._recordings.glob("*.csv"))),
                out=self._gap,
                plant=self.sim,
                set=self._parameters(),
                uncertainty=self.uncertainty,
                free=self.free,
            )()
            vars(self).pop("_verdict", None)
        elif not self.quiet:
            print(f"{self._gap} says: {self._verdict}.")
        if self._verdict == "too_poor":
            raise InputError(
                f"{self._recordings} tells too little of the system to correct a simulation by; "
                "record for longer (--seconds), in another folder."
            )
        return 0

    def _train(self, leg: str) -> int:
        """The rest of a training; 0 where there is none."""
        from mcpilco.logbook import RunFolder

        path = self.out / leg
        if (path / "config.json").exists():
            run = RunFolder.open(path)
            if run.summary() is not None:
                return 0
            return Train(resume=path, quiet=self.quiet)()
        return Train(
            env=self.sim,
            env_kwargs=self._training(leg),
            algo=self.algo,
            preset=self.preset,
            seed=self.seed,
            trials=self._trials,
            out=path,
            quiet=self.quiet,
            **(self._model(leg) if self.algo == "mcpilco" else {}),
        )()

    def _try(self, leg: str) -> int:
        from mcpilco.crossing import Place, cross, write_crossing
        from mcpilco.logbook import RunFolder

        if self._crossing_path(leg).exists():
            return 0
        run = RunFolder.open(self.out / leg)
        env = open_env(self.sim, run.config["env_kwargs"])
        agents = {trial: agent_of(run, trial, env) for trial in run.finished_trials()}
        found = cross(
            {trial: agent.controller for trial, agent in agents.items()},
            simulation=Place(self.sim, run.config["env_kwargs"]),
            system=self._system,
            horizon=next(iter(agents.values())).horizon,
            seed=self.seed,
            episodes=self.episodes,
        )
        env.close()
        write_crossing(self._crossing_path(leg), found)
        return 0

    def _tell(self) -> int:
        from mcpilco.crossing import read_crossing
        from mcpilco.logbook import read_json

        legs = {leg: read_crossing(self._crossing_path(leg)) for leg in LEGS}
        for leg, found in legs.items():
            print(
                f"Trained in the {leg} simulation: it promised {_in_words(found.promised)}, "
                f"the system gave {_in_words(found.happened)}."
            )
        self._draw(legs, read_json(self._gap / "gap.json"))
        return 0

    def _draw(self, legs: Mapping[str, Crossing], gap: Mapping[str, Any]) -> None:
        """The page and the film; what cannot be drawn loses nothing else."""
        from mcpilco.show.crossing_film import write_film
        from mcpilco.show.report.crossing_page import write_crossing_report

        with contextlib.closing(open_env(self.sim, {})) as env:
            scene = getattr(env.unwrapped, "scene", None)
        try:
            if scene is not None:
                write_film(self.out / "crossing.rrd", legs, scene, self.env)
                print(f"Look at it: mcpilco view {self.out}")
            page = write_crossing_report(self.out / "report.html", legs, gap, self._told())
            print(f"Read of it: {page}")
        except McPilcoError as error:
            print(f"mcpilco: without all pictures: {error}", file=sys.stderr)

    # What they are made of ------------------------------------------------------------------------

    @property
    def _recordings(self) -> Path:
        return self.out / "recordings"

    @property
    def _gap(self) -> Path:
        return self.out / "gap"

    def _crossing_path(self, leg: str) -> Path:
        return self.out / f"{leg}.json"

    @property
    def _trials(self) -> int | None:
        by_trials = self.algo in ("mcpilco", "pilco")
        return TRIALS if self.trials is None and by_trials else self.trials

    @cached_property
    def _system(self) -> Place:
        from mcpilco.crossing import Place

        kwargs = keywords("--env-kwargs", self.env_kwargs)
        open_env(self.env, kwargs).close()  # imports its module
        return Place(self.env, kwargs)

    @property
    def _verdict(self) -> str | None:
        """Of an investigation that is complete; None where there is none."""
        from mcpilco.logbook import read_json

        if not (self._gap / "gap.json").exists():
            return None
        verdict = str(read_json(self._gap / "gap.json")["verdict"])
        whole = verdict == "too_poor" or (self._gap / "corrected.json").exists()
        return verdict if whole else None

    def _parameters(self) -> tuple[str, ...]:
        """The keywords of the simulation that are parameters of its plant."""
        from envs import PLANTS

        names = {parameter.name for parameter in PLANTS[self.sim]().parameters}
        return tuple(entry for entry in self.sim_kwargs if entry.partition("=")[0] in names)

    def _training(self, leg: str) -> tuple[str, ...]:
        """Keywords of the simulation of a leg."""
        if leg == "nominal":
            return self.sim_kwargs
        return (*self.sim_kwargs, f"effects={self._gap / 'corrected.json'}")

    def _model(self, leg: str) -> dict[str, Any]:
        """What MC-PILCO knows of a simulation: its equations, and the inputs that it remembers."""
        from mcpilco.agent import task_of
        from mcpilco.crossing import as_mean, remembered_inputs
        from mcpilco.plant import read_correction, write_correction

        if leg == "nominal":
            return {"model": PHYSICS_MODEL}
        correction = read_correction(self._gap / "corrected.json")
        prior = write_correction(self.out / "prior.json", as_mean(correction))
        with contextlib.closing(open_env(self.sim, keywords("", self.sim_kwargs))) as env:
            memory = remembered_inputs(correction, task_of(env, None, quiet=True).dt)
        known = {"model": PHYSICS_MODEL, "prior": prior}
        return {**known, "memory": memory} if memory else known

    def _told(self) -> str:
        return f"{self.env}, {self.seconds:g} s of recordings, simulated by {self.sim}"

    # Checks ---------------------------------------------------------------------------------------

    def _check(self) -> None:
        from envs import PLANTS

        if self.sim not in PLANTS:
            raise InputError(f"--sim must be one of {', '.join(PLANTS)}, got {self.sim!r}.")
        for name in ("trials", "episodes", "rollouts"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"--{name} must be at least 1, got {value}.")
        given = keywords("--sim-kwargs", self.sim_kwargs)
        if "effects" in given:
            raise InputError("--sim-kwargs must leave out effects: they are what is looked for.")
        open_env(self.sim, {**given, "effects": None}).close()

    def _begin(self) -> None:
        """Make the folder, or make sure that it is of the same settings.

        Raises:
            RunFolderError: it is not, or cannot be made.
        """
        from mcpilco.logbook import read_json, write_json

        path = self.out / "cross.json"
        settings = {k: v for k, v in asdict(self).items() if k not in ("out", "quiet")}
        settings["env_kwargs"] = keywords("--env-kwargs", self.env_kwargs)
        settings = _as_json(settings)
        if path.exists():
            if (there := read_json(path)) != settings:
                changed = [k for k in settings if there.get(k) != settings[k]]
                raise RunFolderError(
                    f"{self.out} was begun with another {', '.join(changed)}; name a new folder."
                )
            return
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RunFolderError(
                f"{self.out} cannot be made ({error.strerror or error}); choose another folder."
            ) from error
        write_json(path, settings)


def _in_words(outcome: Any) -> str:
    if outcome.success is None:
        return f"a return of {outcome.returns:.1f}"
    return f"{100 * outcome.success:.0f} % success, a return of {outcome.returns:.1f}"


def _as_json(content: dict[str, Any]) -> dict[str, Any]:
    """As it comes back from a file."""
    import json

    back: dict[str, Any] = json.loads(json.dumps(content))
    return back
