"""Seeds in batches: each fits, acts and is judged by itself, all search for their policies at once.

The searches are where the time goes, and a device that is made for large arrays does those of many
seeds in little more time than one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from mcpilco.sweep.engines import Failure, OnResult, failure_of
from mcpilco.sweep.job import SeedJob, one_thread
from mcpilco.typing import InputError

if TYPE_CHECKING:
    import torch

    from mcpilco.agent import Request


class BatchEngine:
    """Some seeds at a time, in this process, their searches step by step together on one device.

    What a seed raises loses that seed; what a search raises, such as too little memory on the
    device, loses the seeds of its batch.
    """

    def __init__(self, device: str = "cuda", size: int = 64) -> None:
        """An engine for `size` seeds at a time.

        Args:
            device: where particles are rolled out, as torch names it: `cuda`, `cuda:1`, `cpu`.
            size: most seeds in a batch.

        Raises:
            InputError: less than one seed, or torch has no such device.
        """
        if size < 1:
            raise InputError(f"A batch must hold at least 1 seed, got {size}.")
        self.size = size
        self.device = usable_device(device)

    def run(self, jobs: Mapping[int, Any], on_result: OnResult) -> None:
        """Run every job, batch by batch.

        Args:
            jobs: `SeedJob`s by number.
            on_result: called once for each job, as soon as its last trial is judged.
        """
        numbers = list(jobs)
        with one_thread():
            for first in range(0, len(numbers), self.size):
                batch = {number: jobs[number] for number in numbers[first : first + self.size]}
                self._run_batch(batch, on_result)

    def _run_batch(self, jobs: Mapping[int, SeedJob], on_result: OnResult) -> None:
        waiting: dict[int, _Seed] = {}

        def sort(number: int, seed: _Seed) -> None:
            if seed.request is None:
                on_result(number, self._named(seed.outcome))
            else:
                waiting[number] = seed

        for number, job in jobs.items():
            sort(number, _Seed(job))
        while waiting:
            seeds, waiting = waiting, {}
            answers = self._answers([seed.request for seed in seeds.values()])
            for (number, seed), answer in zip(seeds.items(), answers, strict=True):
                seed.go_on(answer)
                sort(number, seed)

    def _answers(self, requests: Sequence[Any]) -> list[Any]:
        """The answer to each request, or why there is none."""
        from mcpilco.agent import search_together

        try:
            return list(search_together(requests, self.device))
        except Exception as error:
            return [failure_of(error)] * len(requests)

    def _named(self, outcome: Any) -> Any:
        """The outcome, with the device among what is told of the machine."""
        if isinstance(outcome, Failure):
            return outcome
        machine = {**outcome["machine"], "device": device_name(self.device)}
        return {**outcome, "machine": machine}


class _Seed:
    """A seed on its way: it has a request, or its outcome."""

    def __init__(self, job: SeedJob) -> None:
        self.request: Request | None = None
        self.outcome: Any = None
        self._learning = job.begin()
        self.go_on(None)

    def go_on(self, answer: Any) -> None:
        """To its next search, or to its end."""
        self.request = None
        if isinstance(answer, Failure):
            self._learning.close()
            self.outcome = answer
            return
        try:
            self.request = self._learning.send(answer)
        except StopIteration as end:
            self.outcome = end.value
        except Exception as error:
            self.outcome = failure_of(error)


def usable_device(name: str) -> torch.device:
    """The device of this name.

    Raises:
        InputError: torch knows none of this name, or has none here.
    """
    import torch

    expected = "expected a device that torch can use here, such as cpu or cuda"
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise InputError(f"{expected}, got {name!r}; name another with --device.") from error
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(
            f"{expected}, got {name!r}, but this torch ({torch.__version__}) finds no CUDA; "
            "install a torch with CUDA and its driver, or leave --device out: a process a core."
        )
    try:
        torch.zeros(1, dtype=torch.float64, device=device).tolist()
    except (RuntimeError, AssertionError, NotImplementedError, TypeError) as error:
        first = str(error).splitlines()[0]
        raise InputError(
            f"{expected}, got {name!r} ({first}); name another with --device."
        ) from error
    return device


def device_name(device: torch.device) -> str:
    """What the device is called by its maker, where torch knows."""
    import torch

    return torch.cuda.get_device_name(device) if device.type == "cuda" else device.type
