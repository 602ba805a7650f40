"""Where jobs run: each in a fresh process, on this machine or on a Ray cluster.

A job that raises, or whose process is killed, loses itself and no other.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import threading
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol

from mcpilco.typing import InputError

Job = Callable[[], Any]
"""work without arguments that can be sent to another process, such as a `functools.partial`"""

_PATIENCE_S = 10.0  # for a process that has delivered, or was told to stop, to end


@dataclass(frozen=True)
class Failure:
    """The reason why a job has no result."""

    reason: str
    """in one line"""
    details: str = ""
    """the traceback, where there is one"""


OnResult = Callable[[int, Any], None]
"""told the number of a job, and its result or `Failure`, as soon as it ends"""


class Engine(Protocol):
    """Runs jobs."""

    def run(self, jobs: Mapping[int, Job], on_result: OnResult) -> None:
        """Run every job once, in any order, and return when all have ended.

        `on_result` is called in this process, once for each job.
        """
        ...


def available_cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalEngine:
    """A fresh interpreter for each job, a few at a time."""

    def __init__(self, workers: int | None = None) -> None:
        """An engine that runs `workers` jobs at a time; by default one a core.

        Raises:
            InputError: less than one worker.
        """
        self.workers = available_cores() if workers is None else workers
        if self.workers < 1:
            raise InputError(f"workers must be at least 1, got {workers}.")

    def run(self, jobs: Mapping[int, Job], on_result: OnResult) -> None:
        """Run every job; when this is interrupted, the jobs that run are stopped."""
        waiting = deque(jobs.items())
        running: dict[Connection, tuple[int, BaseProcess]] = {}
        try:
            while waiting or running:
                while waiting and len(running) < self.workers:
                    number, job = waiting.popleft()
                    receiver, process = _start(job)
                    running[receiver] = number, process
                ready = set(wait(list(running)))
                for receiver in [one for one in running if one in ready]:
                    number, process = running[receiver]  # stays listed until it has ended
                    outcome = _outcome(receiver, process)
                    del running[receiver]
                    on_result(number, outcome)
        finally:
            for _, process in running.values():
                process.terminate()
            for _, process in running.values():
                _end(process)


class RayEngine:
    """A task of one core for each job, on the Ray cluster that `RAY_ADDRESS` names.

    Without `RAY_ADDRESS`, and where no Ray runs yet, it starts one on this machine. Every node
    needs this package, and what the jobs import.
    """

    def __init__(self, retries: int = 5) -> None:
        """An engine that runs a job again, up to `retries` times, when its node or process is lost.

        Raises:
            InputError: the package ray is not installed.
        """
        try:
            import ray
        except ImportError as error:
            raise InputError(
                "The engine ray needs the package ray; run `pip install 'mcpilco[cluster]'`."
            ) from error
        self._ray = ray
        self._retries = retries

    def run(self, jobs: Mapping[int, Job], on_result: OnResult) -> None:
        """Run every job; when this is interrupted, the jobs that run are stopped.

        Raises:
            InputError: there is no cluster at `RAY_ADDRESS`.
        """
        started = self._connect()
        # max_calls: a worker process takes one job, so that none inherits another's state
        task = self._ray.remote(num_cpus=1, max_retries=self._retries, max_calls=1)(attempt)
        running = {task.remote(job): number for number, job in jobs.items()}
        try:
            while running:
                (done, *_), _ = self._ray.wait(list(running), num_returns=1)
                outcome = self._outcome(done)
                on_result(running.pop(done), outcome)
        finally:
            for left in running:
                self._ray.cancel(left, force=True)
            if started:
                self._ray.shutdown()

    def _connect(self) -> bool:
        """Whether there was no connection yet, and now is."""
        if self._ray.is_initialized():
            return False
        address = os.environ.get("RAY_ADDRESS", "")
        try:
            if ":" in address:  # Ray itself would try for minutes
                host, port = address.rsplit("/")[-1].rsplit(":", 1)
                socket.create_connection((host.strip("[]"), int(port)), _PATIENCE_S).close()
            self._ray.init(log_to_driver=False, logging_level=logging.WARNING)
        except (OSError, ValueError) as error:
            raise InputError(
                f"There is no Ray cluster at RAY_ADDRESS={address!r} ({error}); name it as "
                "`ray start --head` printed it, such as 10.0.0.1:6379."
            ) from error
        return True

    def _outcome(self, done: Any) -> Any:
        try:
            return self._ray.get(done)
        except self._ray.exceptions.RayError as error:
            lost = f"the cluster lost it {self._retries + 1} times"
            return Failure(f"{lost} ({type(error).__name__})", str(error))


def attempt(job: Job) -> Any:
    """The result of a job, or its `Failure` where it raises."""
    try:
        return job()
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        return Failure(reason, traceback.format_exc())


def _start(job: Job) -> tuple[Connection, BaseProcess]:
    """A new process that works on the job, and where its outcome will arrive."""
    context = get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_work, args=(job, sender))
    process.start()
    sender.close()  # the process has the only other end: when it dies, the receiver learns of it
    return receiver, process


def _work(job: Job, sender: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides what an interrupt stops
    threading.Thread(target=_end_with_parent, daemon=True).start()
    sender.send(attempt(job))


def _end_with_parent() -> None:
    """End this process when its parent is gone, killed even: nobody waits for its result."""
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _outcome(receiver: Connection, process: BaseProcess) -> Any:
    """The result or failure of a process that ends."""
    delivered: list[Any] = []
    with receiver, suppress(EOFError, OSError):  # it died before, or while, it delivered
        delivered.append(receiver.recv())
    _end(process)
    if delivered:
        return delivered[0]
    code = process.exitcode
    if code is not None and code < 0:
        return Failure(f"its process was killed by {_signal_name(-code)}")
    return Failure(f"its process ended with exit code {code} and no result")


def _end(process: BaseProcess) -> None:
    process.join(_PATIENCE_S)
    if process.is_alive():
        process.kill()
        process.join()


def _signal_name(number: int) -> str:
    with suppress(ValueError):
        return signal.Signals(number).name
    return f"signal {number}"
