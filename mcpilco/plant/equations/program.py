"""The operations of a tape as arrays, which torch and compiled loops can follow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.plant.arithmetic import CONSTANT, INPUT, SINE, Real, Tape, operate

Rows = Callable[[Sequence[Real]], list[Any]]
"""features of [state, input], behind which a state's remembered commands stand"""


@dataclass(frozen=True, eq=False)
class Program:
    """Operations on registers: the inputs first, then constants, then a register an operation."""

    inputs: int
    """I, how many numbers are given"""
    constants: Float[np.ndarray, " C"]
    """values of the registers behind the inputs"""
    operations: Int[np.ndarray, " L"]
    """what each further register is, see `mcpilco.plant.arithmetic`"""
    first: Int[np.ndarray, " L"]
    """register of its operand"""
    second: Int[np.ndarray, " L"]
    """register of the other one, where it has two"""
    outputs: Int[np.ndarray, " O"]
    """registers of the results"""

    @classmethod
    def of(cls, tape: Tape, results: Sequence[Real]) -> Program:
        """The operations that some results need."""
        wanted = [tape.place(result) for result in results]
        needed, waiting = set(range(len(tape.inputs))), list(wanted)
        while waiting:
            place = waiting.pop()
            if place not in needed:
                needed.add(place)
                operation, a, b = tape.nodes[place]
                if operation != CONSTANT:
                    waiting += [int(a), b] if operation < SINE else [int(a)]
        kept = sorted(needed)
        fixed = [p for p in kept if tape.nodes[p][0] == CONSTANT]
        computed = [p for p in kept if tape.nodes[p][0] not in (CONSTANT, INPUT)]
        order = [*range(len(tape.inputs)), *fixed, *computed]
        register = {place: r for r, place in enumerate(order)}
        rows = [tape.nodes[p] for p in computed]

        def indices(places: Sequence[float]) -> Int[np.ndarray, " L"]:
            return np.array([register[int(place)] for place in places], dtype=np.int64)

        return cls(
            inputs=len(tape.inputs),
            constants=np.array([tape.nodes[p][1] for p in fixed], dtype=float),
            operations=np.array([row[0] for row in rows], dtype=np.int64),
            first=indices([row[1] for row in rows]),
            second=indices([row[2] if row[0] < SINE else row[1] for row in rows]),
            outputs=indices(wanted),
        )

    def __call__(self, inputs: Float[Tensor, "*b I"]) -> Float[Tensor, "*b O"]:
        """The results, differentiable in the inputs."""
        results, shape = self.on_tape(inputs.unbind(-1)), inputs.shape[:-1]
        return torch.stack(
            [torch.as_tensor(result, dtype=inputs.dtype).expand(shape) for result in results], -1
        )

    def on_tape(self, inputs: Sequence[Any]) -> list[Any]:
        """The results of numbers of any kind; of a tape's, as part of another program."""
        registers = [*inputs, *self.constants.tolist()]
        rows = zip(self.operations.tolist(), self.first.tolist(), self.second.tolist(), strict=True)
        for operation, a, b in rows:
            registers.append(operate(operation, registers[a], registers[b]))
        return [registers[r] for r in self.outputs]


def features_of(width: int, parts: Sequence[Rows]) -> tuple[Program, tuple[int, ...]]:
    """The program of all features, and how many each part has."""
    tape = Tape(width)
    rows = [part(tape.inputs) for part in parts]
    return Program.of(tape, [x for part in rows for x in part]), tuple(map(len, rows))
