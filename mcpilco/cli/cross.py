"""`mcpilco cross`: from recordings of a system to a policy that was trained in simulation."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from mcpilco.cli import options
from mcpilco.cli.gap import Stages, show_gap
from mcpilco.config import CART_POLE
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.crossing import Crossing, Outcome, Workflow


@dataclass(frozen=True)
class Cross(options.OnMachine):
    """Record a system, correct its simulation, train in both, and try both policies on it.

    Each stage is kept in the folder; the same command goes on where it was stopped.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """folder of everything: recordings, gap, both trainings, what came of them, report.html"""
    env: str = CART_POLE
    """Gymnasium id of the system; `module:Id` imports the module first"""
    env_kwargs: options.EnvKeywords = ()
    """keywords of the system's env; of a JSON file the content"""
    sim: str = CART_POLE
    """id of the env that simulates it, whose plant is corrected; `module:Id` imports the module"""
    sim_kwargs: options.EnvKeywords = ()
    """keywords of the simulation, such as other values of nominal parameters"""
    seconds: float = 60.0
    """of recordings of the system [s]"""
    rollouts: int = 6
    """recordings, of equal length"""
    dt: Annotated[float | None, options.optional("FLOAT", "the env's")] = None
    """sampling time of the recordings [s], for envs with the keyword `dt`"""
    uncertainty: Annotated[tuple[str, ...], tyro.conf.arg(metavar="STD|NAME=STD...")] = ("0.01",)
    """prior std of nominal parameters, as in `mcpilco gap`"""
    free: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME...|all")] = ()
    """parameters of which nothing is known beforehand"""
    algo: options.Algo = "mcpilco"
    """what trains in simulation, where experience costs nothing"""
    preset: options.SuitablePreset = None
    """of the algorithm"""
    trials: Annotated[
        int | None, options.optional("INT", "4, of sac, tqc and ppo the preset's")
    ] = None
    """policies to learn in each simulation; the best there goes to the system"""
    episodes: int = 100
    """fresh ones, that a policy is judged by in simulation and on the system"""
    spread: bool = True
    """learn for all plants that the recordings allow; without, for the likeliest alone"""
    attempts: Annotated[int | None, options.optional("INT", "episodes, on a machine 10")] = None
    """of each policy on the system"""
    seed: int = 0
    """of everything random; equal seeds give equal results"""
    accept: bool = False
    """go on with recordings that look wrong, as in `mcpilco gap`"""
    quiet: bool = False
    """show no progress"""

    def __call__(self) -> int:
        options.register(self.env, self.sim, self.algo)
        options.use_one_thread()
        with self.met(self.out / "machine"):
            return self._cross()

    def _cross(self) -> int:
        from mcpilco.crossing import LEGS

        work = self._workflow()
        work.begin(self._typed())
        stages: list[tuple[str, Callable[[], Any]]] = [
            ("recordings of the system", work.record),
            ("what the simulation lacks", lambda: self._find(work)),
            *(
                (
                    f"training in the {leg} simulation, and the policy on the system",
                    lambda leg=leg: self._learn(work, leg),
                )
                for leg in LEGS
            ),
            ("the story", lambda: self._tell(work)),
        ]
        try:
            for number, (name, stage) in enumerate(stages, start=1):
                if not self.quiet:
                    print(f"\n{number} of {len(stages)}: {name}", flush=True)
                stage()
        except KeyboardInterrupt as stop:  # by a machine with a sentence that says why
            kept = f"{self.out} keeps the stages that have ended, and the same command goes on."
            raise KeyboardInterrupt(" ".join([*stop.args, kept])) from None
        return 0

    # Stages ---------------------------------------------------------------------------------------

    def _find(self, work: Workflow) -> None:
        known = work.verdict
        with Stages().shown(self.quiet):
            found = work.correct(self.accept)
        if found is not None:
            show_gap(found, work.gap, ["gap.json", "corrected.json"])
        elif not self.quiet:
            print(f"{work.gap} says: {known}.")
        work.require_corrected()

    def _learn(self, work: Workflow, leg: str) -> None:
        from mcpilco.show import run_callbacks

        run = work.train(leg, lambda run: run_callbacks(run, progress=not self.quiet))
        if not self.quiet:
            print(f"Run folder: {run.path}")
        work.attempt(leg, self._show)

    def _show(self, number: int, outcome: Mapping[str, float]) -> None:
        """An attempt on a system that takes one at a time."""
        success = outcome.get("is_success")
        verdict = "" if success is None else ", success" if success else ", no success"
        if not self.quiet:
            print(f"attempt {number}: a return of {outcome['return']:.1f}{verdict}", flush=True)

    def _tell(self, work: Workflow) -> None:
        from mcpilco.crossing import LEGS
        from mcpilco.logbook import read_json

        legs = {leg: work.attempt(leg) for leg in LEGS}
        for leg, found in legs.items():
            print(
                f"Trained in the {leg} simulation: it promised {_in_words(found.promised)}, "
                f"the system gave {_in_words(found.happened)}."
            )
        self._draw(legs, read_json(work.gap / "gap.json"))

    def _draw(self, legs: Mapping[str, Crossing], gap: Mapping[str, Any]) -> None:
        """The page and the film; what cannot be drawn loses nothing else."""
        from mcpilco.agent import make_env
        from mcpilco.show import write_crossing_film
        from mcpilco.show.report import write_crossing_report

        about = (
            f"{self.machine or self.env}, {self.seconds:g} s of recordings, simulated by {self.sim}"
        )
        with contextlib.closing(make_env(self.sim)) as env:
            scene = getattr(env.unwrapped, "scene", None)
        with options.without("all pictures"):
            if scene is not None:
                write_crossing_film(self.out / "crossing.rrd", legs, scene, self.env)
                print(f"Look at it: mcpilco view {self.out}")
            page = write_crossing_report(self.out / "report.html", legs, gap, about)
            print(f"Report: {page}")

    # Settings -------------------------------------------------------------------------------------

    def _workflow(self) -> Workflow:
        """The workflow of what was typed; an error where one of its envs cannot be made."""
        from envs import plant_named
        from mcpilco.agent import make_env
        from mcpilco.crossing import CrossingSettings, Place, Workflow

        plant = plant_named("--sim", self.sim, simulated=True)
        options.require_at_least(
            1,
            trials=self.trials,
            episodes=self.episodes,
            rollouts=self.rollouts,
            attempts=self.attempts,
        )
        sim_kwargs = options.keywords("--sim-kwargs", self.sim_kwargs)
        if "effects" in sim_kwargs:
            raise InputError("--sim-kwargs must leave out effects: they are what is looked for.")
        make_env(self.sim, **{**sim_kwargs, "effects": None}).close()
        system, keywords = self._system()
        if not (self.out / "cross.json").exists():
            make_env(system, **keywords).close()
        nominal = [e for e in self.sim_kwargs if e.partition("=")[0] in plant.values]
        settings = CrossingSettings(
            system=Place(system, keywords),
            simulation=Place(self.sim, sim_kwargs),
            seconds=self.seconds,
            rollouts=self.rollouts,
            dt=self.dt,
            uncertainty=options.uncertainty(self.uncertainty),
            free=tuple(options.separated(self.free)),
            algo=self.algo,
            preset=self.preset,
            trials=self.trials,
            episodes=self.episodes,
            spread=self.spread,
            attempts=10 if self.machine and self.attempts is None else self.attempts,
            seed=self.seed,
        )
        return Workflow(
            self.out, settings, plant.where(**options.named_numbers("--sim-kwargs", nominal))
        )

    def _typed(self) -> dict[str, Any]:
        """The settings as they are kept in the folder."""
        beside = ("out", "accept", "quiet", "machine_key")
        settings = {k: v for k, v in asdict(self).items() if k not in beside}
        settings["machine"] = self.machine is not None  # not where: that is typed each time
        settings["env_kwargs"] = options.keywords("--env-kwargs", self.env_kwargs)
        return settings

    def _system(self) -> tuple[str, dict[str, Any]]:
        """Id and keywords of the system's env; a machine is of the kind that --sim simulates."""
        kwargs = options.keywords("--env-kwargs", self.env_kwargs)
        if self.machine is not None and self.env not in (CART_POLE, self.sim):
            raise InputError("--machine takes the place of --env; leave --env out.")
        return self.place(self.env if self.machine is None else self.sim, kwargs)


def _in_words(outcome: Outcome) -> str:
    if outcome.success is None:
        return f"a return of {outcome.returns:.1f}"
    return f"{100 * outcome.success:.0f} % success, a return of {outcome.returns:.1f}"
