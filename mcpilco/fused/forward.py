"""The forward sweep, compiled: states, inputs, and the local Jacobians for the backward sweep.

With the local Jacobians at hand the backward sweep is nearly free, and nothing of size P x N
outlives its block of particles.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mcpilco.fused.arithmetic import OPTIONS
from mcpilco.fused.policy import activate_block, augment_block, squash_block
from mcpilco.fused.posterior import (
    advance_block,
    change_block,
    collect_block,
    kernel_block,
    product_block,
    shift_block,
    weigh_block,
)
from mcpilco.fused.sources import digest


def _compiled(sources: str):
    @njit(**OPTIONS)
    def forward(trace, noise, mask, policy, model, memory):
        """Roll all particles out, block by block, and fill the trace behind its first states."""
        sources  # noqa: B018  closed over, so that a change in any of them compiles this anew
        steps, particles, outputs = noise.shape
        block = memory.x.shape[0]
        n, count = model.alpha.shape[1], model.expand.shape[1]
        x, scaled, phi_of, solved = memory.x, memory.scaled, trace.activations, memory.solved
        half = memory.half
        rows = memory.rows.reshape(block, n)
        groups = memory.groups.reshape(count, block, n)
        weighted = memory.weighted.reshape(count, block, n)
        for first in range(0, particles, block):
            size = min(block, particles - first)
            last = first + size
            for t in range(steps):
                states, inputs = trace.states[t, first:last], trace.inputs[t, first:last]
                phi = phi_of[t, first:last]
                augment_block(size, states, policy, memory)
                np.dot(scaled[:size], policy.centres, phi)
                activate_block(size, first, t, mask, phi)
                np.dot(phi, policy.pulling, memory.pulls[:size])
                squash_block(size, policy, memory, inputs, trace.input_jacobians[t, first:last])
                for e in range(outputs):
                    shift_block(e, size, model, memory)
                    for k in range(count):
                        np.dot(x[:size], model.expand[e, k], groups[k, :size])
                    kernel_block(e, size * n, model, memory)
                    if len(model.solve) == 1:
                        np.dot(rows[:size], model.solve[0, e], solved[:size])
                        product_block(size, rows, solved, memory)
                    else:
                        np.dot(rows[:size], model.solve[0, e], half[:size])
                        np.dot(half[:size], model.solve[1, e], solved[:size])
                        product_block(size, half, half, memory)
                    change_block(e, size, noise[t, first:last], model, memory)
                    weigh_block(e, size * n, model, memory)
                    for k in range(count):
                        np.dot(weighted[k, :size], model.collect[e, k], memory.moments[k, :size])
                    collect_block(e, size, model, memory, trace.delta_jacobians[t, first:last])
                following, frozen = trace.states[t + 1, first:last], trace.frozen[t, first:last]
                advance_block(size, model, memory, states, following, frozen)

    return forward


forward = _compiled(digest())
