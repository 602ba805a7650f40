"""The crossing of the gap: record a system, correct its simulation, train in both, try both.

work = Workflow(Path("out"), CrossingSettings(system, simulation), plant)
work.begin()
work.record()
work.correct()
for leg in LEGS:
    work.train(leg, listeners)
    work.attempt(leg)

Each stage is kept in the folder, and a stage whose result is there is not repeated:

recordings/           of the system, a file a rollout
gap/                  gap.json and corrected.json, as `mcpilco gap` writes them
nominal/, corrected/  run folders of the two trainings
nominal.json, ...     outcomes of their policies, in simulation and on the system
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from mcpilco.agent import (
    agent_of,
    begin_run,
    find,
    learn_rest,
    make_env,
    preset_numbers,
    reopened,
    suitable_preset,
    task_of,
    with_model,
)
from mcpilco.crossing.outcomes import (
    Attempts,
    Crossing,
    Over,
    Place,
    cross,
    read_crossing,
    write_crossing,
)
from mcpilco.crossing.rollouts import record_rollouts
from mcpilco.files import make_folder, require_own
from mcpilco.gap import Gap, investigate
from mcpilco.gap import write_json as write_gap
from mcpilco.logbook import RunFolder, read_json, write_json
from mcpilco.plant import (
    CATALOGUE,
    Addition,
    Correction,
    EffectInstance,
    Spread,
    corrected,
    correction_of,
    instance_in,
    past_inputs,
    read_correction,
    write_correction,
)
from mcpilco.recordings import read_for_plant, write_recording
from mcpilco.typing import InputError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.logbook import Callback
    from mcpilco.plant import Plant


TRIALS = 4
"""of an algorithm that learns by trials"""
JUDGED = 20
"""plants of the posterior, in each of which a policy that must hold for them is judged"""
PHYSICS_MODEL = "physics+rbf"
"""the equations of the simulation, and a residual beside them"""
LEGS = ("nominal", "corrected")
"""the policies that are compared, by the simulation that they are trained in"""

Listeners = Callable[[RunFolder], AbstractContextManager[Sequence["Callback"]]]
"""opens the callbacks of a training that write into its run folder"""


@dataclass(frozen=True)
class CrossingSettings:
    """From which system to which simulation, and how much is measured and learned."""

    system: Place
    """an env that is met only to record it, and once by each policy"""
    simulation: Place
    """the env that simulates it; its plant is corrected"""
    seconds: float = 60.0
    """of recordings of the system [s]"""
    rollouts: int = 6
    """recordings, of equal length"""
    dt: float | None = None
    """sampling time of the recordings [s]; None: the env's"""
    uncertainty: float | Mapping[str, float] = 0.01
    """prior std of nominal parameters, relative [-]"""
    free: tuple[str, ...] = ()
    """parameters of which nothing is known beforehand"""
    algo: str = "mcpilco"
    """registered name of the algorithm that trains in simulation"""
    preset: str | None = None
    """of the algorithm; None: the one that suits its model"""
    trials: int | None = None
    """policies to learn in each simulation; None: `TRIALS`, or those of the preset"""
    episodes: int = 100
    """fresh ones, by which a policy is judged in simulation and on the system"""
    spread: bool = True
    """whether a policy must hold for all plants that the recordings allow, or for the likeliest"""
    attempts: int | None = None
    """of each policy on the system; None: as many as `episodes`"""
    seed: int = 0
    """of everything random; equal seeds give equal results"""


@dataclass(frozen=True)
class Workflow:
    """The stages of a crossing, in one folder.

    What does not fit, the env, the time, the recordings or a run folder, raises McPilcoError.
    """

    out: Path
    """the folder"""
    settings: CrossingSettings
    plant: Plant
    """of the simulation, with its nominal parameters"""

    def begin(self, typed: Mapping[str, Any] | None = None) -> None:
        """Make the folder, or make sure that it was begun with the same settings.

        `typed` are the settings as JSON values, as the user typed them; None: `settings`.

        Raises:
            RunFolderError: it was not, or the folder cannot be made.
        """
        require_own(self.out)
        path = self.out / "cross.json"
        known = asdict(self.settings) if typed is None else dict(typed)
        known = json.loads(json.dumps(known))  # as it comes back from the file
        if path.exists():
            there = read_json(path)
            if changed := [key for key in known if there.get(key) != known[key]]:
                raise RunFolderError(
                    f"{self.out} was begun with another {', '.join(changed)}; name a new folder."
                )
            return
        make_folder(self.out)
        write_json(path, known)

    def record(self) -> list[Path]:
        """The files of the recordings; those that are missing are recorded now.

        A rollout is a file, so that what a system has done is never asked of it again.
        """
        told, paths = self.settings, []
        (self.out / "recordings").mkdir(parents=True, exist_ok=True)
        for k in range(told.rollouts):
            seed = told.rollouts * told.seed + k
            paths.append(self.out / "recordings" / f"excitation-seed{seed}-00.csv")
            if paths[-1].exists():
                continue
            sampled = {} if told.dt is None else {"dt": told.dt}
            kwargs = {**told.system.kwargs, **sampled, "max_episode_steps": -1}
            with contextlib.closing(make_env(told.system.env, **kwargs)) as env:
                seconds, name = told.seconds / told.rollouts, paths[-1].stem
                for recording in record_rollouts(env, "excitation", seconds, [name], seed):
                    write_recording(paths[-1], recording)
        return paths

    @property
    def gap(self) -> Path:
        """Folder of the investigation and of the corrected simulation."""
        return self.out / "gap"

    @property
    def verdict(self) -> str | None:
        """Of an investigation that is complete; None where there is none."""
        if not (self.gap / "gap.json").exists():
            return None
        verdict = str(read_json(self.gap / "gap.json")["verdict"])
        whole = verdict == "too_poor" or (self.gap / "corrected.json").exists()
        return verdict if whole else None

    def correct(self, accept: bool = False) -> Gap | None:
        """Find what the simulation lacks; None where that was found before.

        With `accept` it goes on with recordings that look wrong; the verdict says so first.
        """
        found = None
        if self.verdict is None:
            paths = sorted((self.out / "recordings").glob("*.csv"))
            recordings, _ = read_for_plant(self.plant, paths)
            found = investigate(
                self.plant,
                recordings,
                uncertainty=self.settings.uncertainty,
                free=self.settings.free,
                accepted=() if accept else None,
            )
            self.gap.mkdir(parents=True, exist_ok=True)
            write_gap(found, self.gap / "gap.json")
            if found.verdict != "too_poor":
                write_correction(self.gap / "corrected.json", found.correction)
        return found

    def require_corrected(self) -> None:
        """Raises InputError where the recordings tell too little to correct a simulation by."""
        if self.verdict == "too_poor":
            raise InputError(
                f"{self.out / 'recordings'} holds too little information on the system to correct "
                "a simulation by; record for longer (--seconds), in another folder."
            )

    def train(self, leg: str, listeners: Listeners) -> RunFolder:
        """The run of a leg; what is missing of it is trained now.

        The callbacks of the `listeners` write the run folder.
        """
        path = self.out / leg
        if (path / "config.json").exists():
            run = RunFolder.open(path)
            if run.summary() is None:
                with reopened(path) as (run, agent), listeners(run) as callbacks:
                    learn_rest(run, agent, callbacks)
            return run
        told, kind = self.settings, find(self.settings.algo)
        model = self._model(leg)
        preset = suitable_preset(told.preset, told.algo, model.get("name"))
        config, env_kwargs = preset_numbers(kind, preset, told.simulation.env)
        config = with_model(config, **model)
        env_kwargs |= self._simulation(leg).kwargs
        with contextlib.closing(make_env(told.simulation.env, **env_kwargs)) as env:
            agent = kind(kind.policy_name, env, config=config, seed=told.seed)
            trials = agent.usual_trials(config) if self._trials is None else self._trials
            run = begin_run(path, agent, told.algo, told.simulation.env, env_kwargs, preset, trials)
            with run.writing(), listeners(run) as callbacks:
                learn_rest(run, agent, callbacks)
        return run

    def attempt(self, leg: str, over: Over = lambda number, outcome: None) -> Crossing:
        """Try the best policy of a leg in its simulation and, once, on the system.

        Attempts on a system that takes one at a time are kept as they end, so that none is asked of
        it again; then `over` is called with its number and outcome.
        """
        path = self.out / f"{leg}.json"
        if path.exists():
            return read_crossing(path)
        run, told = RunFolder.open(self.out / leg), self.settings
        kwargs = run.config["env_kwargs"]
        with contextlib.closing(make_env(told.simulation.env, **kwargs)) as env:
            agents = {trial: agent_of(run, trial, env) for trial in run.finished_trials()}
            found = cross(
                {trial: agent.controller for trial, agent in agents.items()},
                simulation=self._possible(Place(told.simulation.env, kwargs), leg),
                system=told.system,
                horizon=next(iter(agents.values())).horizon,
                seed=told.seed,
                episodes=told.episodes,
                attempts=told.attempts,
                kept=Attempts(self.out / f"{leg}-attempts.json", over),
            )
        write_crossing(path, found)
        return found

    @property
    def _trials(self) -> int | None:
        by_trials = self.settings.algo in ("mcpilco", "pilco")
        return TRIALS if self.settings.trials is None and by_trials else self.settings.trials

    def _simulation(self, leg: str) -> Place:
        place = self.settings.simulation
        if leg == "nominal":
            return place
        return Place(place.env, {**place.kwargs, "effects": read_json(self.gap / "corrected.json")})

    def _possible(self, place: Place, leg: str) -> list[Place]:
        """Simulations of plants that the recordings allow, or the one that a policy learned in."""
        members = () if leg == "nominal" else self._correction.spread
        if not (members and self.settings.spread):
            return [place]
        spread = Spread(corrected(self.plant, self._correction), members)
        normal = np.random.default_rng(self.settings.seed).normal(size=(JUDGED, spread.dimensions))
        drawn = spread.plants(normal)
        return [Place(place.env, {**place.kwargs, "effects": correction_of(p)}) for p in drawn]

    @property
    def _correction(self) -> Correction:
        return read_correction(self.gap / "corrected.json")

    def _model(self, leg: str) -> dict[str, Any]:
        """The model of MC-PILCO: the equations of a simulation, and the inputs in its states."""
        if self.settings.algo != "mcpilco":
            return {}
        if leg == "nominal":
            return {"name": PHYSICS_MODEL}
        correction = as_mean(self._correction, self.plant)
        prior = write_correction(self.out / "prior.json", correction)
        spread = {"spread": prior} if self.settings.spread and correction.spread else {}
        place = self.settings.simulation
        with contextlib.closing(make_env(place.env, **place.kwargs)) as env:
            memory = remembered_inputs(correction, task_of(env, None, quiet=True).dt)
        late = {"memory": memory} if memory else {}
        return {"name": PHYSICS_MODEL, "prior": prior, **spread, **late}


def as_mean(correction: Correction, plant: Plant) -> Correction:
    """The part of a correction of a plant that equations can say as a model's mean.

    The rest is learned. Of an effect that they cannot say they say the special cases: of a motor
    under a voltage, viscous friction and a lag.
    """
    written = tuple(said for each in correction.effects for said in _in_equations(each, plant))
    told = {name: instance_in(name) for member in correction.spread for name in member.values}
    kept = [name for name, each in told.items() if each is None or each.effect.in_equations()]
    spread = tuple(member.within(kept) for member in correction.spread)
    return replace(correction, effects=written, learned=(), spread=spread)


def _in_equations(addition: Addition, plant: Plant) -> list[Addition]:
    """An effect as equations can say it: as it is, by its special cases, or not at all."""
    if addition.effect.in_equations():
        return [addition]
    said, own = [], EffectInstance(addition.effect, addition.target)
    motors = zip(plant.layout.actuators, plant.layout.drives, strict=True)
    driving = [motor for motor, joint in motors if plant.layout.joints[joint] == own.target]
    for special in (CATALOGUE[name] for name in own.effect.special):
        for target in [own.target] if special.place == own.effect.place else driving:
            values = own.values_as(EffectInstance(special, target), addition.values)
            named = dict(zip((symbol.name for symbol in special.symbols), values, strict=True))
            said += _in_equations(Addition(special.name, target, named), plant)
    return said


def remembered_inputs(correction: Correction, dt: float) -> int:
    """The number of past inputs that an actuator answers to, in any plant of the spread."""
    late: dict[str, dict[str, float]] = {"actuator_delay": {}, "actuator_lag": {}}
    for member in reversed(correction.spread):
        for name, value in member.values.items():
            if each := instance_in(name):
                late.get(each.effect.name, {})[each.target] = value
    for addition in correction.effects:
        late.get(addition.name, {})[addition.target] = addition.values[0]
    delay, lag = late.values()
    targets = {*delay, *lag}
    return max((past_inputs(delay.get(t, 0.0), lag.get(t, 0.0), dt) for t in targets), default=0)
