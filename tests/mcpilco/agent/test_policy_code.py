"""Laws of exported code: compiled C and ONNX graphs answer as Python does, and say so."""

from __future__ import annotations

import csv
import importlib.util
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mcpilco.agent.numpy_policy import NumpyPolicy
from mcpilco.agent.policy_code import (
    c_source,
    contract,
    golden_vectors,
    prefix_of,
    write_c,
    write_onnx,
)
from mcpilco.agent.policy_file import policy_arrays
from mcpilco.agent.policy_onnx import onnx_model
from mcpilco.typing import InputError
from tests.mcpilco.agent.test_policy_file import ALL, PHYSICS, POSITIONS, RAIL, learned

pytest.importorskip("jinja2")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
ZIG = (sys.executable, "-m", "ziglang", "cc")
KINDS = {
    "states": (ALL, {"kernel": "rbf"}),
    "past": (ALL, {"kernel": "sed-mpk+rbf", "memory": 2}),
    "linear": (POSITIONS, {"kernel": "rbf+mpk"}),
    "late": (ALL, {"kernel": "rbf+mpk", "delay": 0.2}),
    "part": (ALL, {"kernel": "rbf", "delay": 0.13}),
    "linear_late": (POSITIONS, {"kernel": "rbf", "delay": 0.1}),
    "braked": (ALL, {"kernel": "rbf", "limits": (RAIL,)}),
    "past_braked": (ALL, {"kernel": "rbf", "memory": 1, "limits": (RAIL,)}),
    "regulated": (ALL, PHYSICS | {"regulator": 20.0, "limits": (RAIL,)}),
}
SLOW = ("late", "part", "linear_late")


@pytest.fixture(scope="module")
def agents():
    """Small agents of each kind, made when asked for."""
    made: dict[str, object] = {}

    def agent(kind: str):
        if kind not in made:
            env, model = KINDS[kind]
            made[kind] = learned(env, **model)
        return made[kind]

    return agent


def compilers() -> list[list[str]]:
    """gcc, clang and clang for 32 bits: those that this machine has."""
    found = [[name] for name in ("gcc", "clang") if shutil.which(name)]
    if importlib.util.find_spec("ziglang"):
        found += [list(ZIG), [*ZIG, "-target", "x86-linux-musl", "-static"]]
    return found


def checked(compiler: list[str], header: Path, *defined: str) -> tuple[int, float, int]:
    """Golden vectors that the compiled check reads, their largest difference, bytes of state."""
    name = prefix_of(header.stem).upper()
    flags = [f"-D{name}_{word}" for word in ("CHECK", *defined)]
    program = header.with_suffix(".out")
    command = [*compiler, *STRICT, *flags, "-x", "c", str(header), "-o", str(program), "-lm"]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    assert built.stderr == ""
    with header.with_name(f"{header.name}.golden.csv").open() as golden:
        ran = subprocess.run([program], stdin=golden, capture_output=True, text=True)
    assert ran.returncode == 0
    count, difference, size = re.findall(r"[\d.]+(?:e-?\d+)?", ran.stdout)
    return int(count), float(difference), int(size)


def written(write, agent, path: Path, vectors: int) -> Path:
    return write(path, agent.policy, agent.task, agent.estimator, vectors)[0]


def golden(path: Path) -> np.ndarray:
    with path.with_name(f"{path.name}.golden.csv").open() as file:
        return np.array([list(map(float, row)) for row in list(csv.reader(file))[1:]])


def agrees_in_c(agent, path: Path, vectors: int, chosen: list[list[str]]) -> None:
    header = written(write_c, agent, path, vectors)
    sizes = json.loads(header.with_name(f"{header.name}.json").read_text())["state"]["bytes"]
    for compiler in chosen:
        count, difference, size = checked(compiler, header)
        assert (count, size) == (vectors, sizes["double"])
        assert difference < 1e-6
        count, difference, size = checked(compiler, header, "FLOAT")
        assert (count, size) == (vectors, sizes["float"])
        assert difference < 5e-3  # of +-10 N: a float has seven digits


@pytest.mark.one_in(3)
@pytest.mark.skipif(not compilers(), reason="no C compiler")
@pytest.mark.parametrize(
    ("kind", "compiler"),
    [
        ("past", 0),
        ("part", 0),
        ("past_braked", 0),
        pytest.param("past", -1, marks=pytest.mark.slow),  # zig builds a C library first, a minute
        pytest.param("regulated", 0, marks=pytest.mark.slow),
    ],
)
def test_compiled_c_answers_as_numpy(kind: str, compiler: int, agents, tmp_path: Path) -> None:
    agrees_in_c(agents(kind), tmp_path / f"{kind}.h", 150, [compilers()[compiler]])


@pytest.mark.slow
@pytest.mark.skipif(not compilers(), reason="no C compiler")
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_golden_vectors_agree_in_c(kind: str, agents, tmp_path: Path) -> None:
    agrees_in_c(agents(kind), tmp_path / f"{kind}.h", 10_000, compilers())


@pytest.mark.one_in(3)
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in SLOW])
@pytest.mark.parametrize("vectors", [200, pytest.param(10_000, marks=pytest.mark.slow)])
def test_golden_vectors_agree_in_onnx(kind: str, vectors: int, agents, tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    path = written(write_onnx, agents(kind), tmp_path / "policy.onnx", vectors)
    about = json.loads(path.with_name("policy.onnx.json").read_text())
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    begins = {name: np.array([state["begins"]]) for name, state in about["state"].items()}
    names = [output.name for output in session.get_outputs()]
    worst, state = 0.0, begins
    for first, *row in golden(path):
        measured, expected = np.split(np.array([row]), [len(about["measured"])], axis=1)
        state = begins if first else state
        found = dict(zip(names, session.run(None, {"measured": measured, **state}), strict=True))
        state = {name: found[f"next_{name}"] for name in begins}
        worst = max(worst, np.abs(found["inputs"] - expected).max())
    assert worst < 1e-6


def test_the_exported_brake_is_at_work(agents) -> None:
    agent = agents("braked")
    arrays = arrays_of(agent)
    free = {name: array for name, array in arrays.items() if not name.startswith("brake.")}
    fast = np.array([0.3, 2.0, 0.0, 0.0])
    assert agent.policy.brake.holds
    assert NumpyPolicy(arrays)(fast)[0] < -9.9 < NumpyPolicy(free)(fast)[0]
    assert "braked" in contract(arrays)["kind"]
    assert "braked" not in contract(free)["kind"]


def test_the_exported_regulator_is_at_work(agents) -> None:
    arrays = arrays_of(agents("regulated"))
    free = {name: a for name, a in arrays.items() if not name.startswith("regulator.")}
    rows = np.array([row[1:-1] for row in golden_vectors(arrays, 500)])
    differ = [not np.array_equal(NumpyPolicy(arrays)(x), NumpyPolicy(free)(x)) for x in rows]
    assert 50 < sum(differ) < 450
    assert "a regulator near its goal, braked" in contract(arrays)["kind"]


def test_an_onnx_graph_takes_a_batch(agents, tmp_path: Path) -> None:
    runtime = pytest.importorskip("onnxruntime")
    path = written(write_onnx, agents("states"), tmp_path / "policy.onnx", 40)
    rows = golden(path)
    session = runtime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    found = session.run(["inputs"], {"measured": np.ascontiguousarray(rows[:, 1:5])})[0]
    np.testing.assert_allclose(found, rows[:, 5:], atol=1e-6)


def test_a_late_actuator_has_no_onnx_graph(agents) -> None:
    agent = agents("part")
    with pytest.raises(InputError, match="late actuator.*--c policy.h"):
        onnx_model(policy_arrays(agent.policy, agent.task, agent.estimator))


def arrays_of(agent) -> dict[str, np.ndarray]:
    return policy_arrays(agent.policy, agent.task, agent.estimator)


@pytest.mark.slow
@pytest.mark.skipif(not compilers(), reason="no C compiler")
def test_the_oldest_step_of_a_late_actuator_gives_way_in_c_too(agents, tmp_path: Path) -> None:
    arrays = arrays_of(agents("late")) | {"delay.recent": np.array(3)}
    header = tmp_path / "short.h"
    header.write_text(c_source(arrays, "short"))
    rows = list(golden_vectors(arrays, 150))
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    header.with_name("short.h.golden.csv").write_text(f"names\n{text}\n")
    assert max(np.diff([i for i, row in enumerate(rows) if row[0]])) > 5
    assert checked(compilers()[0], header)[1] < 1e-6


@pytest.mark.parametrize("kind", ["linear", "part"])
def test_golden_vectors_are_the_agents_answers(kind: str, agents) -> None:
    agent, act = agents(kind), None
    for first, *row in golden_vectors(arrays_of(agent), 30):
        act = agent.on_states() if first or act is None else act
        measured, expected = np.split(np.array(row), [len(agent.task.measured_states)])
        np.testing.assert_allclose(act(measured), expected, rtol=1e-6, atol=1e-6)


def test_the_contract_says_names_units_order_rate_and_limits(agents) -> None:
    agent = agents("linear")
    about = contract(arrays_of(agent))
    assert about["measured"] == [
        {"name": "cart_position", "unit": "m"},
        {"name": "pole_angle", "unit": "rad"},
    ]
    limits = {"low": float(agent.low[0]), "high": float(agent.high[0])}
    assert about["inputs"] == [{"name": "force", "unit": "N", **limits}]
    assert about["rate_hz"] == pytest.approx(1 / agent.task.dt)
    assert "linear estimator" in about["kind"]


@pytest.mark.skipif(not compilers(), reason="no C compiler")
def test_c_refuses_what_is_not_finite_and_remembers_nothing_of_it(agents, tmp_path: Path) -> None:
    arrays = arrays_of(agents("linear")) | {"state_units": np.array(["*/", "/*", "a\nb", "m"])}
    (tmp_path / "policy.h").write_text(c_source(arrays, "policy"))
    policy = NumpyPolicy(arrays)
    expected = [policy(np.array(y))[0] for y in ([0.1, 0.2], [0.3, 0.1])]
    (tmp_path / "main.c").write_text(
        '#include <stdio.h>\n#include "policy.h"\n'
        "int main(void)\n{\n"
        "    policy_state s;\n"
        "    policy_real y[3][2] = {{0.1, 0.2}, {0, 0}, {0.3, 0.1}}, u[1] = {7};\n"
        "    int i;\n    y[1][1] = HUGE_VAL;\n    policy_reset(&s);\n"
        '    for (i = 0; i < 3; i++)\n        printf("%d ", policy_step(&s, y[i], u)),'
        ' printf("%.17g ", u[0]);\n    return 0;\n}\n'
    )
    command = [*compilers()[0], *STRICT, "main.c", "-o", "main", "-lm"]
    subprocess.run(command, check=True, cwd=tmp_path)
    said = subprocess.run([tmp_path / "main"], capture_output=True, text=True).stdout.split()
    assert said[::2] == ["1", "0", "1"]
    np.testing.assert_allclose([float(x) for x in said[1::2]], np.repeat(expected, [2, 1]))


@pytest.mark.parametrize(
    ("stem", "prefix"), [("policy", "policy"), ("My-Arm", "my_arm"), ("2nd", "policy_2nd")]
)
def test_names_in_a_header_begin_as_its_file(stem: str, prefix: str) -> None:
    assert prefix_of(stem) == prefix


@pytest.mark.skipif(not compilers(), reason="no C compiler")
def test_the_c_of_the_documentation_compiles(agents, tmp_path: Path) -> None:
    page = (Path(__file__).parents[3] / "docs" / "microcontroller.md").read_text()
    declared, called = re.search(r"```c\n(.*?)\n\n(policy_reset.*?)```", page, re.S).groups()
    (tmp_path / "policy.h").write_text(c_source(arrays_of(agents("linear")), "policy"))
    machine = "static void command(double force) { (void)force; }\nstatic void stop(void) {}\n"
    text = f"{declared}\n{machine}int main(void)\n{{\n{called}return 0;\n}}\n"
    (tmp_path / "main.c").write_text(text)
    command = [*compilers()[0], *STRICT, "main.c", "-o", "main", "-lm"]
    subprocess.run(command, check=True, cwd=tmp_path)
    subprocess.run([tmp_path / "main"], check=True)
