"""A machine as a Gymnasium env: the task of its simulation, and steps in real time."""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import os
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float

from mcpilco.agent import input_bounds, make_env, task_of
from mcpilco.files import make_folder
from mcpilco.machine.link import parsed
from mcpilco.machine.loop import urge
from mcpilco.typing import EnvError, InputError

logger = logging.getLogger(__name__)

MACHINE = "mcpilco/Machine-v0"
"""id of the env"""
PATIENCE_S = 5.0
"""for which a machine is asked for an answer [s]"""


@dataclass(frozen=True)
class MachineSettings:
    """How a machine is watched."""

    rate: float = 100.0
    """commands a second [Hz]; a step of the task lasts a whole number of them"""
    watchdog: float = 0.05
    """longest time from the start of a step to its command; then the safe one is sent [s]"""
    silence: float = 0.25
    """longest time without a credible measurement in an episode [s]"""
    jump: float = 0.25
    """largest difference between the move of a position from one measurement to the next and what
    its velocity says, in its unit"""
    homing: float = 60.0
    """longest time in which the machine must be back at its start [s]"""
    limits: Mapping[str, Sequence[float]] = field(default_factory=dict)
    """smallest and largest value of states, by name, in their units; beyond them an episode ends"""
    inputs: Sequence[float] | None = None
    """largest input in either direction, each in its unit; None: those of the simulation"""

    def __post_init__(self) -> None:
        for name in ("rate", "watchdog", "silence", "jump", "homing"):
            value = getattr(self, name)
            if not (isinstance(value, int | float) and 0 < value < float("inf")):
                raise InputError(f"{name} of a machine must be a positive number, got {value!r}.")
        for name, pair in dict(self.limits).items():
            if np.shape(pair) != (2,) or not pair[0] < pair[1]:
                raise InputError(
                    f"limits of a machine must be pairs [low, high] by state, got {name}: {pair!r}."
                )


# The address --------------------------------------------------------------------------------------


@dataclass
class Meeting:
    """The address that a user typed, and the process that drives the machine there."""

    address: str
    log: Path | None
    key: bytes
    process: subprocess.Popen[bytes] | None = None
    socket: socket.socket | None = None
    told: dict[str, Any] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    episodes: int = 0

    def open(self, told: Mapping[str, Any]) -> None:
        """The process of the loop, greeted by the machine; one that runs with the same is kept."""
        if self.process is not None and self.process.poll() is None and told == self.told:
            return
        self.close()
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        paths = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        command = [sys.executable, "-P", "-m", "mcpilco.machine.loop", str(there.fileno())]
        with there:
            self.process = subprocess.Popen(command, pass_fds=[there.fileno()], env=paths)
        self.socket, self.told = here, dict(told)
        own = {"address": self.address, "key": self.key.hex(), "patience": PATIENCE_S}
        own["thread"] = threading.get_native_id()
        self.send({**told, **own})
        answer = self.hear(PATIENCE_S + told["homing"])
        if answer["is"] != "open":
            self.close()
            raise EnvError(answer["why"])
        logger.info("%s: %s, %s", self.address, told, answer)

    def send(self, message: Mapping[str, Any]) -> None:
        try:
            assert self.socket is not None, "open() comes first"
            self.socket.send(json.dumps(message).encode())
        except OSError as error:
            raise EnvError(f"The loop of {self.address} has ended: {error}; try again.") from None

    def hear(self, seconds: float) -> dict[str, Any]:
        assert self.socket is not None, "open() comes first"
        self.socket.settimeout(seconds)
        try:
            message = self.socket.recv(1 << 20)
        except OSError:
            message = b""
        if not message:
            self.close()
            raise EnvError(
                f"The loop that keeps the time of {self.address} has ended; the machine is safe by "
                "its own watchdog. The same command goes on."
            )
        answer = json.loads(message)
        self.counts = answer.pop("counts", self.counts)
        return answer

    def close(self) -> None:
        """The machine gets its safe command, and the process ends."""
        if self.socket is not None:
            self.socket.close()
        if self.process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.process.wait(2.0)
            self.process.kill()
            self.process.wait()
            urge(0, 0)  # in case it was killed in an episode
        self.process = self.socket = None

    def new_log(self) -> str | None:
        """The file of the next episode."""
        if self.log is None:
            return None
        make_folder(self.log)
        while True:
            path = self.log / f"episode-{self.episodes:04d}.csv"
            self.episodes += 1
            if not path.exists():
                return str(path.absolute())


_met: Meeting | None = None


@contextlib.contextmanager
def meeting(
    address: str, log: str | Path | None = None, key: str | Path | None = None
) -> Iterator[None]:
    """Within it, envs of `mcpilco/Machine-v0` drive the machine at an address.

    Args:
        address: `udp://HOST:PORT` or `serial:///dev/NAME?baud=115200`, as the user typed it.
        log: folder of a recording for each episode; None: nothing is kept.
        key: file of up to 32 bytes that the machine knows too; None: whoever sees its packets can
            write others.

    Raises:
        InputError: the address is none, or the key cannot be read.
    """
    global _met  # noqa: PLW0603  the one place where an address comes from
    parsed(address)
    try:
        secret = b"" if key is None else Path(key).read_bytes().strip()
    except OSError as error:
        raise InputError(f"Cannot read the key {key}: {error.strerror}.") from None
    if len(secret) > 32:
        raise InputError(f"A key must have at most 32 bytes, got {len(secret)} in {key}.")
    before, _met = _met, Meeting(address, None if log is None else Path(log), secret)
    try:
        yield
    finally:
        _met.close()
        _met = before


def machine_of(
    simulation: str, kwargs: Mapping[str, Any], settings: Mapping[str, Any]
) -> tuple[str, dict[str, Any]]:
    """Id and keywords of the env of a machine that a simulation is of.

    Raises:
        EnvError: there is no such simulation.
    """
    make_env(simulation, **{**kwargs}).close()
    steps = gym.spec(simulation.rpartition(":")[2]).max_episode_steps
    limited = {} if steps is None else {"max_episode_steps": steps}
    return MACHINE, {"simulation": simulation, **limited, **settings, **kwargs}


# The env ------------------------------------------------------------------------------------------


class MachineEnv(gym.Env[np.ndarray, np.ndarray]):
    """Steps of a machine, at the rate of its task, by the clock of a process of its own.

    Spaces, names, units, cost and the rule of success are those of the simulation. `reset` brings
    the machine to its start by its own routine; the clock runs from the first `step` on, and each
    step returns what was measured when the next one is due. The input of a step acts from when
    `step` is called. A step that is late is counted; one that is later than the watchdog, a silent
    machine and a sensor that jumps raise EnvError, with the machine safe. A stop by hand raises
    KeyboardInterrupt, so that nothing goes on by itself. A state beyond its limits terminates the
    episode.

    `info` has `machine`, counts since the loop began: `ticks`, `missed` (steps whose command came
    after their end), `late ticks`, `lost` and `late` measurements, `stale` (steps without a
    measurement of their own: the newest, moved on by its velocity), `jumps` (measurements refused),
    packets that were `oversized`, `malformed`, `forged`, `replayed`; `age_s`, of the measurement;
    `latency_s`, the longest from the start of a step to its command in this episode.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012

    def __init__(self, simulation: str, render_mode: str | None = None, **keywords: Any) -> None:
        """The machine that a simulation is of.

        Keywords are those of `MachineSettings`; all others go to the simulation.

        Raises:
            EnvError: no address was typed.
            InputError: a keyword does not fit.
        """
        if _met is None:
            raise EnvError(
                "A machine is met only at an address that you type: --machine udp://HOST:PORT, in "
                "Python `with mcpilco.machine.meeting(address):`; no file can name it."
            )
        self._met = _met
        own = {name: keywords.pop(name) for name in asdict(MachineSettings()) if name in keywords}
        self.settings = MachineSettings(**own)
        simulated = make_env(simulation, **keywords)
        self.task = task_of(simulated, None, quiet=True)
        self.observation_space = simulated.observation_space
        low, high = input_bounds(simulated)
        if self.settings.inputs is not None:
            most = np.broadcast_to(self.settings.inputs, low.shape).astype(float)
            low, high = np.maximum(low, -most), np.minimum(high, most)
        self.action_space = gym.spaces.Box(low, high, dtype=np.float64)
        self.scene = getattr(simulated.unwrapped, "scene", None)
        self._swing_up: Any = getattr(simulated.unwrapped, "swing_up", None)
        self._judge = None if self._swing_up is None else self._swing_up.judge()
        simulated.close()
        self._told = self._for_loop()
        self._step: int | None = None
        self._tidies = gc.get_freeze_count() == 0  # what a program has frozen stays so

    def _for_loop(self) -> dict[str, Any]:
        task, settings = self.task, self.settings
        states = [task.state_names[i] for i in task.measured_states]
        place = {state: i for i, state in enumerate(task.measured_states)}
        pairs = [(place[q], place[v]) for q, v in task.velocities if q in place and v in place]
        if strange := set(settings.limits) - set(states):
            raise InputError(
                f"limits of a machine must name measured states, {', '.join(states)}, got "
                f"{', '.join(sorted(strange))}."
            )
        self._ticks = round(task.dt * settings.rate)
        if self._ticks < 1 or abs(self._ticks / settings.rate - task.dt) > 1e-6 * task.dt:
            raise InputError(
                f"rate of a machine must be a multiple of {1 / task.dt:g} Hz, as a step takes "
                f"{task.dt:g} s, got {settings.rate:g}."
            )
        numbers = {name: value for name, value in asdict(settings).items() if name != "inputs"}
        safe = np.clip(np.zeros(len(task.input_names)), *input_bounds(self)).tolist()
        names = {"states": states, "names": task.input_names, "pairs": pairs}
        return {**numbers, **names, "safe": safe}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float[np.ndarray, " Y"], dict[str, Any]]:
        """Brings the machine to its start; where it begins is not chosen by the seed.

        Raises:
            EnvError: it does not answer, or does not come back in time.
        """
        super().reset(seed=seed)
        answer = self._begun()
        if answer["is"] == "silent":  # it may have been switched off and on since
            self._met.close()
            answer = self._begun()
        if answer["is"] != "ready":
            raise self._fault(answer)
        self._step = 0
        if self._judge is not None:
            self._judge.restart()
        self._last = np.array(answer["values"])
        return self._last, self._info(answer)

    def _begun(self) -> dict[str, Any]:
        self._met.open(self._told)
        self._met.send({"do": "begin", "ticks": self._ticks, "log": self._met.new_log()})
        if self._tidies:  # on the machine's way to its start memory is cleared: what is left then
            gc.unfreeze()
            gc.collect()
            gc.freeze()  # costs the collections of an episode no time
        while True:
            answer = self._met.hear(self.settings.homing + 2 * PATIENCE_S)
            if answer["is"] in ("ready", "silent", "homing", "stopped"):
                return answer

    def step(
        self, action: Float[np.ndarray, " U"]
    ) -> tuple[Float[np.ndarray, " Y"], float, bool, bool, dict[str, Any]]:
        """Sends the inputs, and returns what is measured when the next ones are due.

        Raises:
            EnvError: the machine or the learner was too late, see above.
        """
        if self._step is None:
            raise gym.error.ResetNeeded("The machine is not at its start; call reset() first.")
        inputs = np.clip(np.asarray(action, dtype=np.float64), *input_bounds(self))
        if not np.isfinite(inputs).all():
            raise InputError(f"The inputs of a machine must be finite numbers, got {action!r}.")
        self._met.send({"do": "act", "step": self._step, "inputs": inputs.tolist()})
        answer = self._met.hear(self._ticks / self.settings.rate + 2 * PATIENCE_S)
        limit = answer["is"] == "limit"
        if answer["is"] != "step" and not limit:
            self._step = None
            raise self._fault(answer)
        self._step = None if limit else self._step + 1
        observed = np.array(answer["values"])
        reward = self._judged(answer["path"] or [answer["values"]], inputs)
        self._last = observed
        info = self._info(answer)
        if limit:
            info["fault"] = answer["why"]
            logger.warning("The episode ended safely: %s.", answer["why"])
        return observed, reward, limit, False, info

    def close(self) -> None:
        """Leaves the machine safe; its address stays met."""
        if self._met.process is not None and self._met.process.poll() is None:
            with contextlib.suppress(EnvError):
                self._met.send({"do": "end"})
        if self._tidies:
            gc.unfreeze()

    def _judged(self, path: Sequence[Sequence[float]], inputs: Float[np.ndarray, " U"]) -> float:
        """The reward of a step, whose measurements the judge has seen."""
        states = self._whole(np.array(path))
        if self._judge is not None:
            looks = np.linspace(0, len(states) - 1, self._swing_up.samples).round().astype(int)
            self._judge.watch(states[looks])
            return float(self._swing_up.reward(states[-1], inputs))
        if self.task.cost is None:
            return 0.0
        with torch.no_grad():
            return 1.0 - float(self.task.cost(torch.tensor(states[-1]), torch.tensor(inputs)))

    def _whole(self, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, "T X"]:
        """States with the mean velocities of the step, where these are not measured."""
        states = np.zeros((len(measured), len(self.task.state_names)))
        known = list(self.task.measured_states)
        states[:, known] = measured
        for q, v in self.task.velocities:
            if v not in known:
                moved = measured[-1, known.index(q)] - self._last[known.index(q)]
                states[:, v] = moved / self.task.dt
        return states

    def _info(self, answer: Mapping[str, Any]) -> dict[str, Any]:
        verdict = {} if self._judge is None else self._judge.verdict()
        timing = {"age_s": answer.get("age", 0.0), "latency_s": answer.get("worst", 0.0)}
        said = {name: value.item() for name, value in verdict.items()}
        return {**said, "machine": {**self._met.counts, **timing}}

    def _fault(self, answer: Mapping[str, Any]) -> EnvError | KeyboardInterrupt:
        told = f"The machine at {self._met.address} was made safe: {answer['why']}."
        if answer["is"] == "stopped":
            self._met.close()
            return KeyboardInterrupt(told)
        return EnvError(
            f"{told} Look at it, then give the same command again; what was measured before is "
            "kept."
        )


def register() -> None:
    """Make the env known to Gymnasium."""
    if MACHINE not in gym.registry:
        entry = "mcpilco.machine:MachineEnv"
        gym.register(MACHINE, entry_point=entry, disable_env_checker=True)


register()
