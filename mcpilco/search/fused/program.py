"""A program of `mcpilco.plant.equations` for a block of particles, compiled, and the way back.

Each register is a row of particles, so that an operation is a loop over a vector, and what decides
which operation it is costs little beside it. The way back takes the derivatives of a cost by the
results to those by state and inputs; no Jacobian is formed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mcpilco.plant import (
    ABS,
    ADD,
    COSINE,
    DIVIDE,
    EXP,
    MAXIMUM,
    MINIMUM,
    MULTIPLY,
    SINE,
    SQRT,
    SUBTRACT,
    TANH,
)
from mcpilco.search.fused.arithmetic import PLAIN


@njit(**PLAIN)
def load(program, state, inputs, memory):
    """Hands a block's states and inputs to the program."""
    registers, width = memory.registers, state.shape[1]
    for i in range(state.shape[0]):
        for p in range(width):
            registers[i, p] = state[i, p]
    for i in range(inputs.shape[0]):
        for p in range(width):
            registers[state.shape[0] + i, p] = inputs[i, p]


@njit(**PLAIN)
def prepare(program, first, memory):
    """Fills the constants of a block of particles: their own numbers, and everybody's."""
    if program is None:
        return
    registers, numbers, constants = memory.registers, program.numbers, program.constants
    at = program.given - numbers.shape[0]
    for k in range(numbers.shape[0]):
        for p in range(registers.shape[1]):
            registers[at + k, p] = numbers[k, first + p]
    for k in range(constants.size):
        for p in range(registers.shape[1]):
            registers[program.given + k, p] = constants[k]


@njit(**PLAIN)
def run(program, memory):
    """Fills the registers of all operations."""
    registers = memory.registers
    at = program.given + program.constants.size
    for i in range(program.operations.size):
        operation = program.operations[i]
        x, y = registers[program.first[i]], registers[program.second[i]]
        r = registers[at + i]
        if operation == MULTIPLY:
            for p in range(r.size):
                r[p] = x[p] * y[p]
        elif operation == ADD:
            for p in range(r.size):
                r[p] = x[p] + y[p]
        elif operation == SUBTRACT:
            for p in range(r.size):
                r[p] = x[p] - y[p]
        elif operation == DIVIDE:
            for p in range(r.size):
                r[p] = x[p] / y[p]
        elif operation == SINE:
            for p in range(r.size):
                r[p] = math.sin(x[p])
        elif operation == COSINE:
            for p in range(r.size):
                r[p] = math.cos(x[p])
        elif operation == SQRT:
            for p in range(r.size):
                r[p] = math.sqrt(x[p])
        elif operation == TANH:
            for p in range(r.size):
                r[p] = math.tanh(x[p])
        elif operation == EXP:
            for p in range(r.size):
                r[p] = math.exp(x[p])
        elif operation == ABS:
            for p in range(r.size):
                r[p] = abs(x[p])
        elif operation == MINIMUM:
            for p in range(r.size):
                r[p] = y[p] if y[p] < x[p] else x[p]
        elif operation == MAXIMUM:
            for p in range(r.size):
                r[p] = y[p] if y[p] > x[p] else x[p]


@njit(**PLAIN)
def evaluate(program, memory, state, inputs, out):
    """The results of a block's states and inputs, if there is a program."""
    if program is None:
        return
    load(program, state, inputs, memory)
    run(program, memory)
    for i in range(program.outputs.size):
        value = memory.registers[program.outputs[i]]
        for p in range(value.size):
            out[i, p] = value[p]


@njit(**PLAIN)
def clear_adjoints(memory):
    """No derivative by any register yet."""
    adjoints = memory.adjoints
    for i in range(adjoints.shape[0]):
        for p in range(adjoints.shape[1]):
            adjoints[i, p] = 0.0


@njit(**PLAIN)
def _divide_back(g, r, x, y, gx, gy):
    for p in range(g.size):
        part = g[p] / y[p]
        gx[p] += part
        gy[p] -= part * r[p]


@njit(**PLAIN)
def _choose_back(g, r, x, y, gx, gy):
    for p in range(g.size):
        first = r[p] == x[p]
        gx[p] += g[p] if first else 0.0
        gy[p] += 0.0 if first else g[p]


@njit(**PLAIN)
def _unary_back(operation, g, r, x, gx):
    if operation == SINE:
        for p in range(g.size):
            gx[p] += g[p] * math.cos(x[p])
    elif operation == COSINE:
        for p in range(g.size):
            gx[p] -= g[p] * math.sin(x[p])
    elif operation == SQRT:
        for p in range(g.size):
            gx[p] += 0.5 * g[p] / r[p]
    elif operation == TANH:
        for p in range(g.size):
            gx[p] += g[p] * (1.0 - r[p] * r[p])
    elif operation == EXP:
        for p in range(g.size):
            gx[p] += g[p] * r[p]
    elif operation == ABS:
        for p in range(g.size):
            gx[p] += g[p] if x[p] > 0.0 else (-g[p] if x[p] < 0.0 else 0.0)


@njit(**PLAIN)
def run_back(program, memory):
    """From the derivatives by the results, in their adjoints, to those by all registers."""
    registers, adjoints = memory.registers, memory.adjoints
    at = program.given + program.constants.size
    for i in range(program.operations.size - 1, -1, -1):
        if not program.live[at + i]:
            continue
        operation, a, b = program.operations[i], program.first[i], program.second[i]
        g, gx, gy = adjoints[at + i], adjoints[a], adjoints[b]
        x, y, r = registers[a], registers[b], registers[at + i]
        if operation == MULTIPLY:
            if program.live[a]:
                for p in range(g.size):
                    gx[p] += g[p] * y[p]
            if program.live[b]:
                for p in range(g.size):
                    gy[p] += g[p] * x[p]
        elif operation == ADD:
            for p in range(g.size):
                gx[p] += g[p]
            for p in range(g.size):
                gy[p] += g[p]
        elif operation == SUBTRACT:
            for p in range(g.size):
                gx[p] += g[p]
            for p in range(g.size):
                gy[p] -= g[p]
        elif operation == DIVIDE:
            _divide_back(g, r, x, y, gx, gy)
        elif operation in (MINIMUM, MAXIMUM):
            _choose_back(g, r, x, y, gx, gy)
        else:
            _unary_back(operation, g, r, x, gx)


def live_registers(program, differentiable: int) -> np.ndarray:
    """Which registers depend on the first inputs, by which a cost is differentiated."""
    registers = program.inputs + len(program.constants) + len(program.operations)
    live = np.zeros(registers, dtype=np.uint8)
    live[:differentiable] = 1
    at = program.inputs + len(program.constants)
    for i, (a, b) in enumerate(zip(program.first, program.second, strict=True)):
        live[at + i] = live[a] | live[b]
    return live
