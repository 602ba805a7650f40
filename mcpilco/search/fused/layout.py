"""How the compiled loops see a model, a policy and their own memory: plain arrays of one precision.

Particles are the last axis of everything, so that a loop over them is a loop over vectors; they go
through a time step in blocks, whose numbers stay in the cache. Constant matrices are packed for
`mcpilco.search.fused.tiles`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from mcpilco.dynamics import GPDynamics
from mcpilco.kernels import Term
from mcpilco.plant import Program
from mcpilco.policies import SumOfGaussians, program_of
from mcpilco.search.fused.program import live_registers
from mcpilco.search.fused.tiles import TALL, pack, strip

FORWARD_STRIPS = 8
BACKWARD_STRIPS = 4
"""width of a block: forwards a matrix that was fetched serves more particles in a wider one;
backwards none is, and what a step needs stays closer to the processor in a narrower one"""


def padded(count: int, dtype: np.dtype) -> int:
    """The next multiple of a strip."""
    return -(-count // strip(dtype)) * strip(dtype)


def blocks(particles: int, strips: int, dtype: np.dtype) -> list[tuple[int, int, int]]:
    """How particles go through a time step together: (first, last, width) of equal blocks."""
    width, end = strips * strip(dtype), padded(particles, dtype)
    whole = end // width * width
    parts = [(0, whole, width), (whole, end, end - whole)]
    return [part for part in parts if part[0] < part[1]]


class ModelArrays(NamedTuple):
    """A posterior and the law of motion, constant for a whole search.

    A kernel is a sum of K terms v exp(-1/2 |x - x_j|^2_w) prod_f (c_f + <x, x_j>_s_f). Each of
    the exponents and of the F factors is linear in [x, 1] but for a part that depends on x alone:
    it is a "group", the product of a constant matrix with [x, 1, shifts].
    """

    alpha: np.ndarray
    """(E, N)"""
    whiten: np.ndarray
    """(E, packed N, N), L^-1"""
    unwhiten: np.ndarray
    """(E, packed N, N), L^-T"""
    expand: np.ndarray
    """(E, packed G rows, D + 1 + exponents), from [x, 1, shifts] to groups; exponents come first"""
    collect: np.ndarray
    """(E, packed D + exponents, G rows), from weighted groups to moments and the exponents' mass"""
    middle: np.ndarray
    """(D,), where exponents are expanded"""
    v: np.ndarray
    """(E, K)"""
    w: np.ndarray
    """(E, K, D)"""
    c: np.ndarray
    """(E, F)"""
    s: np.ndarray
    """(E, F, D)"""
    exponent: np.ndarray
    """(K,), the group of each term's exponent, or -1"""
    ends: np.ndarray
    """(K + 1,), where the factors of each term begin and end; factors are the last groups"""
    floor: np.ndarray
    """(E,), smallest variance"""
    A: np.ndarray
    """(X, X), from the state to the next one"""
    C: np.ndarray
    """(X, U), from the inputs to the next state; (0, U) where it holds none"""
    B: np.ndarray
    """(X, E), from the changes to the next state"""
    predicted: np.ndarray
    """(E,), which states the changes belong to"""
    bounds: np.ndarray
    """(E,), largest plausible magnitude of those states"""


class ProgramArrays(NamedTuple):
    """A program of `mcpilco.plant.equations`."""

    given: int
    """inputs: state, inputs of the model, and numbers of each particle"""
    constants: np.ndarray
    """(C,), the registers behind the inputs"""
    operations: np.ndarray
    """(L,)"""
    first: np.ndarray
    """(L,), register of an operand"""
    second: np.ndarray
    """(L,), register of the other"""
    outputs: np.ndarray
    """(O,), registers of the results"""
    live: np.ndarray
    """(registers,), 1 where it depends on state or inputs"""
    numbers: np.ndarray
    """(K, P), each particle's own"""


class PhysicsArrays(NamedTuple):
    """Arrays that physics adds to a model; what is None is not even compiled."""

    drift: ProgramArrays | None
    """the next state without the GPs' changes, in place of A x + C u"""
    features: ProgramArrays | None
    """further regressors"""
    weights: np.ndarray
    """(E, N, P), of the samples in each particle's posterior beyond alpha; N is 0 where equal"""


class PolicyArrays(NamedTuple):
    """A policy: two products with a squashing between them."""

    plain: np.ndarray
    """components of the state that are no angle"""
    angles: np.ndarray
    """components that are"""
    centres: np.ndarray
    """(packed B, Z + 2), from [z / l, 1, -|z / l|^2] to the exponents of the bases"""
    inv_scale: np.ndarray
    """(Z,), 1 / l"""
    pulling: np.ndarray
    """(packed U (Z + 1), B), from activations to sum_b w_b phi_b [c_b / l, 1]"""
    squash: np.ndarray
    """(3, U): centre, half range, scale"""
    brake: ProgramArrays | None
    """from [state, commands] to inputs, a regulator before it; None: these are the commands"""


class Mask(NamedTuple):
    """Dropout of the policy's bases."""

    keys: np.ndarray
    """(T,), of the hash"""
    threshold: int
    """bytes below it drop their basis"""
    scale: np.ndarray
    """(1,), factor of the bases that stay"""


class Trace(NamedTuple):
    """Written by the forward sweep, read by the backward sweep; P is padded to whole strips."""

    states: np.ndarray
    """(T + 1, X, P), the first row given; behind them those of `mcpilco.search.fused.sensing`"""
    commands: np.ndarray
    """(T, U, P), before the brake"""
    inputs: np.ndarray
    """(T, U, P), the same array where there is no brake"""
    delta_jacobians: np.ndarray
    """(T, K E, D, P), d delta / d [z, u] of the K rows of a particle that move"""
    input_jacobians: np.ndarray
    """(T, U, Z, P), du / dz"""
    frozen: np.ndarray
    """(T, K, P), 1 where the row stayed where it was"""


class PolicyMemory(NamedTuple):
    """Memory of the policy for one block of particles, the last axis of everything."""

    z: np.ndarray
    """(Z, P), the augmented states"""
    scaled: np.ndarray
    """(Z + 2, P): z / l, 1, -|z / l|^2"""
    phi: np.ndarray
    """(B padded, P), activations, dropout included"""
    flat_phi: np.ndarray
    """the same, as one row"""
    pulls: np.ndarray
    """(U (Z + 1) padded, P)"""
    slope: np.ndarray
    """(P,)"""
    words: np.ndarray
    """(2, P), hashes"""
    brake: ProgramMemory | None


class ModelMemory(NamedTuple):
    """Memory of the posterior for one block of particles, the last axis of everything."""

    x: np.ndarray
    """(D + 1 + exponents, P): z, u, 1, shifts"""
    groups: np.ndarray
    """(G N padded, P)"""
    flat_groups: np.ndarray
    """(G, N P) of the same"""
    flat_factors: np.ndarray
    """(F, N P) of the same"""
    kernel: np.ndarray
    """(N padded, P), k(X, x)"""
    flat_kernel: np.ndarray
    white: np.ndarray
    """(N padded, P), L^-1 k"""
    solved: np.ndarray
    """(N padded, P), u = K^-1 k, then g = alpha - (eps / sd) u"""
    flat_solved: np.ndarray
    term: np.ndarray
    """(N padded, P)"""
    flat_term: np.ndarray
    moments: np.ndarray
    """(D + exponents padded, P)"""
    delta: np.ndarray
    """(E, P)"""
    squares: np.ndarray
    """(F, P), c + <x, x>_s"""
    slope: np.ndarray
    """(D, P), derivative of the prior variance"""
    mean: np.ndarray
    """(P,)"""
    prior: np.ndarray
    """(P,), k(x, x)"""
    explained: np.ndarray
    """(P,), |L^-1 k|^2"""
    ratio: np.ndarray
    """(P,), eps / sd"""


class ProgramMemory(NamedTuple):
    """Memory of a program for one block of particles."""

    registers: np.ndarray
    """(registers, P)"""
    adjoints: np.ndarray
    """(registers, P), the derivatives by them"""


class PhysicsMemory(NamedTuple):
    """Memory of physics for one block of particles."""

    drift: ProgramMemory | None
    features: ProgramMemory | None


class AdjointMemory(NamedTuple):
    """Derivatives of the cost for one block."""

    following: np.ndarray
    """(X, P), with respect to the next state"""
    current: np.ndarray
    """(X, P), to the state"""
    z: np.ndarray
    """(Z, P), to the augmented state"""
    mu: np.ndarray
    """(U, P), to the inputs"""
    delta: np.ndarray
    """(E, P), to the changes"""
    columns: np.ndarray
    """(P, U (1 + 2 Z) padded), to the policy's argument, times [1, z, z^2]"""


@torch.no_grad()
def model_arrays(dynamics: GPDynamics, dtype: np.dtype) -> ModelArrays:
    """The arrays of a model.

    The factorisation is that of float64, whatever the precision of the arrays: rounded L^-1 gives
    variances without a sign error, rounded K^-1 does not.

    Raises:
        NoCanonicalFormError: its kernel is no sum of canonical terms.
    """
    posterior, C = dynamics.posterior, dynamics.increment.C
    form = posterior.kernel.canonical()
    X, terms = form.regressors(posterior.X), form.terms
    middle = X.mean(0)
    whiten, unwhiten = pack(posterior.L_inv.numpy()), pack(posterior.L_inv.mT.numpy())
    _, panels, _, height = whiten.shape
    slopes, offsets, masses = _groups(X, middle, terms, panels * height)
    has_exponent = np.array([_has_exponent(term) for term in terms])

    def real(array: Tensor | np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(array, dtype=dtype)

    return ModelArrays(
        alpha=real(posterior.alpha),
        whiten=real(whiten),
        unwhiten=real(unwhiten),
        expand=real(pack(torch.cat([slopes, offsets, masses], -1).numpy())),
        collect=real(pack(torch.cat([slopes, masses], -1).mT.numpy())),
        middle=real(middle),
        v=real(torch.stack([term.v for term in terms], -1)),
        w=real(torch.stack([term.w for term in terms], -2)),
        c=real(torch.cat([term.c for term in terms], -1)),
        s=real(torch.cat([term.s for term in terms], -2)),
        exponent=np.where(has_exponent, np.cumsum(has_exponent) - 1, -1),
        ends=np.cumsum([0, *(term.c.shape[-1] for term in terms)]),
        floor=real(posterior.smallest_variance),
        A=real(dynamics.increment.A),
        C=real(C if C.any() else C[:0]),
        B=real(dynamics.increment.B),
        predicted=np.array(dynamics.predicted, dtype=np.int64),
        bounds=real(dynamics.bounds),
    )


def program_arrays(program: Program, numbers: np.ndarray | None, dtype: np.dtype) -> ProgramArrays:
    """The arrays of a program.

    It is of [state, inputs, each particle's own numbers], the last of which are `numbers`, (K, P).
    """
    own: np.ndarray = np.zeros((0, 0), dtype) if numbers is None else numbers.astype(dtype)
    return ProgramArrays(
        program.inputs,
        program.constants.astype(dtype),
        program.operations,
        program.first,
        program.second,
        program.outputs,
        live_registers(program, program.inputs - len(own)),
        np.ascontiguousarray(own),
    )


def program_memory(program: ProgramArrays | None, width: int) -> ProgramMemory | None:
    """Fresh memory for blocks of this width."""
    if program is None:
        return None
    shape, dtype = (len(program.live), width), program.constants.dtype
    return ProgramMemory(np.empty(shape, dtype), np.empty(shape, dtype))


def physics_memory(physics: PhysicsArrays, width: int) -> PhysicsMemory:
    """Fresh memory for blocks of this width."""
    programs = physics.drift, physics.features
    return PhysicsMemory(*(program_memory(program, width) for program in programs))


def _has_exponent(term: Term) -> bool:
    return bool((term.w != 0).any())


def _groups(
    X: Tensor, middle: Tensor, terms: list[Term], rows: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Slopes (E, G rows, D) and offsets (E, G rows, 1) of all groups; which exponent a row is of.

        -1/2 |x - x_j|^2_w = <x, m_j>_w - 1/2 <m_j + 2 middle, m_j>_w - 1/2 |x - middle|^2_w

    with m_j = x_j - middle; the last part is the shift, which depends on x alone.
    """
    shifted = X - middle
    slopes, offsets = [], []
    for term in filter(_has_exponent, terms):
        slopes.append(term.w[:, None, :] * shifted)
        offsets.append(-(term.w[:, None, :] * shifted * (shifted / 2 + middle)).sum(-1))
    exponents = len(slopes)
    for term in terms:
        for c, s in zip(term.c.unbind(-1), term.s.unbind(-2), strict=True):
            slopes.append(s[:, None, :] * X)
            offsets.append(c[:, None].expand(-1, len(X)))
    slope, offset = torch.stack(slopes, 1), torch.stack(offsets, 1)[..., None]
    mass = X.new_zeros(*slope.shape[:-1], exponents)
    for k in range(exponents):
        mass[:, k, :, k] = 1.0
    padding = (0, 0, 0, rows - len(X))  # behind the last sample
    slope, offset, mass = (
        torch.nn.functional.pad(t, padding).flatten(1, 2) for t in (slope, offset, mass)
    )
    return slope, offset, mass


def policy_arrays(policy: SumOfGaussians, dtype: np.dtype) -> PolicyArrays:
    """The arrays of a policy; `fused.policy.prepare` fills those that are learned."""
    augmentation, squash = policy.augmentation, policy.squash
    bases, z_width = policy.centres.shape
    pulls = policy.input_dim * (z_width + 1)
    bounds = squash.centre.numpy(), squash.half_range.numpy()
    program = program_of(policy.behind)
    return PolicyArrays(
        plain=np.array(augmentation.plain, dtype=np.int64),
        angles=np.array(augmentation.angles, dtype=np.int64),
        centres=pack(np.zeros((bases, z_width + 2), dtype), TALL),
        inv_scale=np.empty(z_width, dtype),
        pulling=pack(np.zeros((pulls, bases), dtype)),
        squash=np.stack([*bounds, np.full_like(bounds[0], squash.scale)]).astype(dtype),
        brake=None if program is None else program_arrays(program, None, dtype),
    )


def rows_of(packed: np.ndarray) -> int:
    """Rows of a packed matrix, padding included."""
    return packed.shape[-3] * packed.shape[-1]


def policy_memory(policy: PolicyArrays, width: int) -> PolicyMemory:
    """Fresh memory for blocks of this width."""
    dtype, z_width = policy.inv_scale.dtype, len(policy.inv_scale)
    bases = policy.pulling.shape[1]
    phi = np.empty((-(-rows_of(policy.centres) // 4) * 4, width), dtype)  # a hash serves four
    return PolicyMemory(
        z=np.empty((z_width, width), dtype),
        scaled=np.empty((z_width + 2, width), dtype),
        phi=phi,
        flat_phi=phi[:bases].reshape(-1),
        pulls=np.empty((rows_of(policy.pulling), width), dtype),
        slope=np.empty(width, dtype),
        words=np.empty((2, width), np.uint32),
        brake=program_memory(policy.brake, width),
    )


def model_memory(model: ModelArrays, width: int) -> ModelMemory:
    """Fresh memory for blocks of this width."""
    dtype, regressors, factors = model.alpha.dtype, len(model.middle), model.c.shape[1]
    samples, rows = rows_of(model.whiten[0]), model.collect.shape[2]
    groups = np.empty((rows_of(model.expand[0]), width), dtype)
    flat = groups[:rows].reshape(rows // samples, -1)
    kernel, white, solved, term = (np.empty((samples, width), dtype) for _ in range(4))
    mean, prior, explained, ratio = (np.empty(width, dtype) for _ in range(4))
    return ModelMemory(
        x=np.empty((model.expand.shape[2], width), dtype),
        groups=groups,
        flat_groups=flat,
        flat_factors=flat[len(flat) - factors :],
        kernel=kernel,
        flat_kernel=kernel.reshape(-1),
        white=white,
        solved=solved,
        flat_solved=solved.reshape(-1),
        term=term,
        flat_term=term.reshape(-1),
        moments=np.empty((rows_of(model.collect[0]), width), dtype),
        delta=np.empty((len(model.alpha), width), dtype),
        squares=np.empty((factors, width), dtype),
        slope=np.empty((regressors, width), dtype),
        mean=mean,
        prior=prior,
        explained=explained,
        ratio=ratio,
    )


def adjoint_memory(model: ModelArrays, policy: PolicyArrays, width: int) -> AdjointMemory:
    """Fresh memory for blocks of this width."""
    dtype, z_width, inputs = model.alpha.dtype, len(policy.inv_scale), policy.squash.shape[1]
    following, current = (np.empty((len(model.A), width), dtype) for _ in range(2))
    return AdjointMemory(
        following=following,
        current=current,
        z=np.empty((z_width, width), dtype),
        mu=np.empty((inputs, width), dtype),
        delta=np.empty((len(model.alpha), width), dtype),
        columns=np.zeros((width, padded(inputs * (1 + 2 * z_width), dtype)), dtype),
    )
