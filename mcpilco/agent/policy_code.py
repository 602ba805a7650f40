"""A policy for machines without Python: C99 source or an ONNX graph, each with what proves it.

Beside `policy.h` stand `policy.h.json`, its contract: names, units, order, rate and limits of what
goes in and out, and the size of the memory; and `policy.h.golden.csv`, golden vectors: what numpy
answers to episodes of random measurements. So with `policy.onnx`.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from mcpilco.agent.numpy_policy import STAGES, NumpyPolicy
from mcpilco.agent.policy_file import policy_arrays
from mcpilco.files import csv_bytes, write_bytes
from mcpilco.policies import SumOfGaussians
from mcpilco.task import TaskSpec
from mcpilco.typing import Estimator, InputError

Arrays = Mapping[str, np.ndarray]
"""of a policy's file, see `mcpilco.agent.policy_file`"""

VECTORS = 10_000
"""golden vectors that are written"""
EPISODE = 125
"""steps of an episode of golden vectors: longer than any memory"""
WANDERING = 0.9
"""correlation of successive golden measurements [-]"""
WIDEST = 3.0
"""an episode of them ends so many standard deviations of the centres from their mean [-]"""
NEAR = 0.05
"""of these, those about a regulator's goal, near which every other episode stays [-]"""
C_FORMS: tuple[str, ...] = (
    "{} + {}",
    "{} - {}",
    "{} * {}",
    "{} / {}",
    "M(fmin)({}, {})",
    "M(fmax)({}, {})",
)
C_FORMS += tuple(f"M({name})({{}})" for name in ("sin", "cos", "tanh", "exp", "sqrt", "fabs"))
"""of the operations of a program, by their numbers"""
_TEMPLATE = Path(__file__).with_name("policy.h.j2")


def write_c(
    path: str | Path,
    policy: SumOfGaussians,
    task: TaskSpec,
    estimator: Estimator | None = None,
    vectors: int = VECTORS,
) -> tuple[Path, Path, Path]:
    """Write a policy, with its estimator, as one C99 header; returns the paths of the three files.

    The functions that it defines begin with the name of the file; it needs no other file, allocates
    nothing, computes in double, or in float where `POLICY_FLOAT` is defined, and is C++ too. The
    estimator of a late actuator computes in double always: in float its variances cancel.

    Args:
        path: of the header, such as `policy.h`.
        policy: what is written.
        task: of the env in which it was learned.
        estimator: as of `mcpilco.agent.write_policy`.
        vectors: golden vectors beside it, 0 or more.

    Raises:
        InputError: jinja2 is missing, or the policy cannot be exported.
        RunFolderError: a file cannot be written.
    """
    arrays, path = policy_arrays(policy, task, estimator), Path(path)
    source, about = c_source(arrays, path.stem), contract(arrays)
    reals = state_reals(arrays)
    sizes = {"double": 8 * reals + 8, "float": (8 if "delay.part" in arrays else 4) * reals + 8}
    about |= {"prefix": prefix_of(path.stem), "state": {"numbers": reals, "bytes": sizes}}
    return _written(path, source.encode(), about, arrays, vectors)


def write_onnx(
    path: str | Path,
    policy: SumOfGaussians,
    task: TaskSpec,
    estimator: Estimator | None = None,
    vectors: int = VECTORS,
) -> tuple[Path, Path, Path]:
    """Write a policy, with its estimator, as an ONNX graph; returns the paths of the three files.

    The graph maps `measured` (batch, Y) to `inputs` (batch, U), in double. What the policy
    remembers goes in and comes out as further tensors: feed each `next_NAME` back as `NAME`; the
    contract says what they are when an episode begins. Arguments are those of `write_c`.

    Raises:
        InputError: onnx is missing, or the estimator is that of a late actuator.
        RunFolderError: a file cannot be written.
    """
    from mcpilco.agent.policy_onnx import onnx_model

    arrays = policy_arrays(policy, task, estimator)
    about = contract(arrays)
    model, memory = onnx_model(arrays, json.dumps(about))
    state = {name: {"width": len(v), "begins": v.tolist()} for name, v in memory.items()}
    return _written(Path(path), model, about | {"state": state}, arrays, vectors)


def _written(
    path: Path, content: bytes, about: dict[str, Any], arrays: Arrays, vectors: int
) -> tuple[Path, Path, Path]:
    """The paths of an exported policy, its contract and its golden vectors."""
    golden, said = (path.with_name(f"{path.name}.{end}") for end in ("golden.csv", "json"))
    about = {"file": path.name, "golden": {"file": golden.name, "vectors": vectors}} | about
    names = ["begins", *(x["name"] for x in about["measured"] + about["inputs"])]
    write_bytes(golden, csv_bytes(names, golden_vectors(arrays, vectors)))
    write_bytes(said, (json.dumps(about, indent=1) + "\n").encode())
    return write_bytes(path, content), said, golden


def contract(arrays: Arrays) -> dict[str, Any]:
    """How to connect an exported policy to a machine: names, units, order, rate and limits."""
    from mcpilco import __version__

    named = zip(arrays["state_names"].tolist(), arrays["state_units"].tolist(), strict=True)
    states = [{"name": name, "unit": unit} for name, unit in named]
    low, high = (arrays["middle"] + sign * arrays["half_range"] for sign in (-1, 1))
    inputs = zip(arrays["input_names"], arrays["input_units"], low, high, strict=True)
    dt = float(arrays["dt"])
    return {
        "made_by": f"mcpilco {__version__}",
        "kind": kind_of(arrays),
        "dt_s": dt,
        "rate_hz": 1 / dt,
        "measured": [states[i] for i in arrays["measured"]],
        "inputs": [
            {"name": str(name), "unit": str(unit), "low": float(least), "high": float(most)}
            for name, unit, least, most in inputs
        ],
        "angles": [states[i]["name"] for i in arrays["angles"]],
    }


def kind_of(arrays: Arrays) -> str:
    """The parts of a policy, in words."""
    parts = {
        "estimator.A": "a linear estimator",
        "delay.whole": "a late actuator's state tracker",
        "past_inputs": "past inputs",
    }
    behind = [words for name, words in parts.items() if name in arrays]
    stages = {"regulator": ", a regulator near its goal", "brake": ", braked before limits"}
    after = "".join(words for name, words in stages.items() if f"{name}.outputs" in arrays)
    return f"a sum of Gaussians behind {' and '.join(behind) or 'the sensors'}{after}"


def golden_vectors(arrays: Arrays, count: int) -> Iterator[list[float]]:
    """Rows of (1 where an episode begins, what is measured, what numpy answers).

    Measurements wander over where the policy has its centres. Where it has a model of the motion
    they follow that, with noise, as long as they stay there: the answers to what cannot be hang on
    the last digit. Where there is a regulator, every other episode is near its goal. What is
    measured is exact in float too, so that code in float is asked the same.
    """
    policy, random = NumpyPolicy(arrays), np.random.default_rng(0)
    X, angles, measured = len(arrays["state_names"]), arrays["angles"], arrays["measured"]
    plain = np.delete(np.arange(X), angles)
    centres, noise = arrays["centres"][:, : len(plain)], arrays.get("delay.noise_std", 0.0)
    centre, spread = np.zeros(X), np.full(X, np.pi / 2)
    centre[plain], spread[plain] = centres.mean(0), np.maximum(centres.std(0), 1e-6)
    places = [(centre, spread)]
    if "regulator.goal" in arrays:
        places.append((arrays["regulator.goal"][:X], NEAR * spread))
    left, x, around = 0, centre, itertools.cycle(places)
    for _ in range(count):
        normal, expected = random.normal(size=X), policy.expected() if left else None
        if expected is not None:
            x = expected + noise * normal
            left *= bool((np.abs(x - centre)[plain] < WIDEST * spread[plain]).all())
        begins = left == 0
        if begins:
            policy.reset()
            left, (centre, spread) = EPISODE, next(around)
        if begins or expected is None:
            share = 0.0 if begins else WANDERING
            x = centre + share * (x - centre) + np.sqrt(1 - share**2) * spread * normal
        left -= 1
        seen = x[measured].astype(np.float32).astype(float)
        yield [int(begins), *seen.tolist(), *policy(seen).tolist()]


# --- C --------------------------------------------------------------------------------------------


def prefix_of(stem: str) -> str:
    """The beginning of all names in the header of a file."""
    name = re.sub(r"[^a-z0-9_]", "_", stem.lower())
    return name if name[:1].isalpha() else f"policy_{name}"


def c_source(arrays: Arrays, stem: str) -> str:
    """The header of a policy.

    Raises:
        InputError: jinja2 is missing.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError as error:
        raise InputError(
            "A policy is written as C by jinja2; install it with: pip install 'mcpilco[report]'"
        ) from error
    environment = Environment(
        block_start_string="@%",
        block_end_string="%@",
        variable_start_string="@{",
        variable_end_string="}@",
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    template = environment.from_string(_TEMPLATE.read_text(encoding="utf-8"))
    return template.render(_numbers(arrays, stem))


def _numbers(arrays: Arrays, stem: str) -> dict[str, Any]:
    """The values of the names in the template."""
    about, prefix = contract(arrays), prefix_of(stem)
    X, U = len(arrays["state_names"]), len(arrays["middle"])
    past = int(arrays.get("past_inputs", 0)) * U
    groups = {
        group: {k.partition(".")[2]: v for k, v in arrays.items() if k.startswith(f"{group}.")}
        for group in ("estimator", "delay", "motion", "model")
    }
    angles = arrays["angles"].tolist()
    return {
        "p": prefix,
        "P": prefix.upper(),
        "version": about["made_by"].removeprefix("mcpilco "),
        "kind": about["kind"],
        "dt": about["dt_s"],
        "rate": f"{about['rate_hz']:g}",
        "measured": [tuple(map(_comment, x.values())) for x in about["measured"]],
        "inputs": [tuple(map(_comment, x.values())) for x in about["inputs"]],
        "X": X,
        "U": U,
        "seen": X + past,
        "past": past,
        "angles": angles,
        "plain": [i for i in range(X + past) if i not in angles],
        "squash": repr(float(arrays["squash"])),
        "inverse_lengthscales": 1 / arrays["lengthscales"],
        "linear": groups["estimator"],
        "stages": {
            name: _program_lines(arrays, name, X + past, prefix)
            for name in STAGES
            if f"{name}.outputs" in arrays
        },
        "late": _late(X, U, **groups) if groups["delay"] else {},
        **{name: arrays[name] for name in ("centres", "weights", "middle", "half_range")},
    }


def _program_lines(arrays: Arrays, stage: str, seen: int, prefix: str) -> list[str]:
    """The program behind a policy as declarations and assignments in C."""
    number, U = f"{prefix}_number", len(arrays["middle"])
    lines: list[str] = []
    registers = [*(f"x[{i}]" for i in range(seen)), *(f"inputs[{i}]" for i in range(U))]
    registers += [f"({number}){constant:.17g}" for constant in arrays[f"{stage}.constants"]]
    names = ("operations", "first", "second")
    rows = zip(*(arrays[f"{stage}.{name}"] for name in names), strict=True)
    for operation, a, b in rows:
        form = C_FORMS[operation].replace("M(", f"{prefix.upper()}_M(")
        name = f"r{len(lines)}"
        lines.append(f"const {number} {name} = {form.format(registers[a], registers[b])};")
        registers.append(name)
    results = (registers[i] for i in arrays[f"{stage}.outputs"])
    return lines + [f"inputs[{i}] = {result};" for i, result in enumerate(results)]


def _comment(value: Any) -> str:
    """A text that ends no comment of C, and begins none."""
    return re.sub(r"\*/|/\*", "* /", " ".join(str(value).split()))


def _late(X: int, U: int, delay: Arrays, motion: Arrays, model: Arrays, **_: Arrays) -> dict:
    """The sizes and the numbers of a late actuator's state tracker."""
    samples = np.concatenate([model["X"], model["X"] @ model["W"]], -1)
    part = float(delay["part"])
    integrated = motion["B"].copy()
    integrated[motion["predicted"]] = 0.0
    lower = np.tril_indices(len(samples))
    return {
        "recent": int(delay["recent"]),
        "whole": int(delay["whole"]),
        "commands": int(delay["whole"]) + (part > 0) + 1,
        "turns": part > 0,
        "N": len(samples),
        "E": len(motion["predicted"]),
        "K": model["v"].shape[1],
        "F": model["c"].shape[1],
        "asked": model["X"].shape[1],
        "D": samples.shape[1],
        "predicted": motion["predicted"].tolist(),
        "ends": model["ends"].tolist(),
        "tables": {
            "part": delay["part"] if part > 0 else np.empty(0),
            "noise": delay["noise_std"],
            "bounds": motion["bounds"],
            "integrated": integrated,
            "samples": samples,
            "L_inv": model["L_inv"][:, *lower],
            "W": model["W"].T,
            "noise_of_changes": model["noise_std"],
            **{name: motion[name] for name in ("A", "B", "C")},
            **{name: model[name] for name in ("alpha", "v", "w", "c", "s")},
        },
    }


def state_reals(arrays: Arrays) -> int:
    """How many numbers the C code remembers from step to step, of `float` or `double`."""
    numbers = _numbers(arrays, "policy")
    X, U, late = numbers["X"], numbers["U"], numbers["late"]
    reals = (X if numbers["linear"] else 0) + numbers["past"]
    if late:
        R, N, E, D = (late[name] for name in ("recent", "N", "E", "D"))
        reals += late["commands"] * U + X + X * X + R * D + R * R + N
        reals += E * (2 * R + R * R + R * N + 2 * N)
    return reals
