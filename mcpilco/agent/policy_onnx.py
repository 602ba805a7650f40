"""A policy as an ONNX graph, node by node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mcpilco.agent.numpy_policy import STAGES
from mcpilco.plant import SINE
from mcpilco.typing import InputError

OPSET, IR = 17, 8
"""versions of the operators, and of the file that goes with them [-]"""
_ROW = np.array([-1])
OPERATORS = ("Add", "Sub", "Mul", "Div", "Min", "Max", "Sin", "Cos", "Tanh", "Exp", "Sqrt", "Abs")
"""of a program, by their numbers; those from `SINE` on take one number"""


class _Graph:
    """A graph that grows: called with an operator and tensors, it returns the result's name."""

    def __init__(self) -> None:
        from onnx import TensorProto, helper, numpy_helper

        self._helper, self._from_array = helper, numpy_helper.from_array
        self._double = TensorProto.DOUBLE
        self._nodes: list[Any] = []
        self._constants: list[Any] = []
        self._inputs: list[Any] = []
        self._outputs: list[Any] = []

    def __call__(self, operator: str, *tensors: str | np.ndarray, **attributes: Any) -> str:
        result = f"t{len(self._nodes)}"
        names = [t if isinstance(t, str) else self._constant(t) for t in tensors]
        self._nodes.append(self._helper.make_node(operator, names, [result], **attributes))
        return result

    def _constant(self, array: np.ndarray) -> str:
        name = f"c{len(self._constants)}"
        self._constants.append(self._from_array(np.ascontiguousarray(array), name))
        return name

    def input(self, name: str, width: int) -> str:
        """A tensor (batch, width) that comes in."""
        self._inputs.append(self._tensor(name, width))
        return name

    def output(self, name: str, width: int, tensor: str) -> None:
        """Let a tensor (batch, width) go out by a name."""
        self._nodes.append(self._helper.make_node("Identity", [tensor], [name]))
        self._outputs.append(self._tensor(name, width))

    def _tensor(self, name: str, width: int) -> Any:
        return self._helper.make_tensor_value_info(name, self._double, ["batch", width])

    def model(self, says: str) -> bytes:
        """The file."""
        from onnx import checker

        graph = self._helper.make_graph(
            self._nodes, "policy", self._inputs, self._outputs, self._constants, says
        )
        opset = self._helper.make_opsetid("", OPSET)
        model = self._helper.make_model(
            graph, producer_name="mcpilco", opset_imports=[opset], ir_version=IR
        )
        checker.check_model(model)
        return model.SerializeToString()


def onnx_model(
    arrays: Mapping[str, np.ndarray], says: str = ""
) -> tuple[bytes, dict[str, np.ndarray]]:
    """The graph of a policy, and what it remembers when an episode begins, by name.

    Arrays are those of the policy's file; the graph carries what it `says` of itself.

    Raises:
        InputError: onnx is missing, or the actuator is late.
    """
    if "delay.whole" in arrays:
        raise InputError(
            "The policy of a late actuator conditions a Gaussian process in each step, for which "
            "ONNX has no operators; export it as C (--c policy.h), or as arrays (policy.npz)."
        )
    try:
        graph = _Graph()
    except ImportError as error:
        raise InputError(
            "An ONNX graph needs onnx; install it with: pip install 'mcpilco[onnx]'"
        ) from error
    memory: dict[str, np.ndarray] = {}
    x = graph.input("measured", len(arrays["measured"]))
    if "estimator.A" in arrays:
        memory |= {"expected": arrays["estimator.start"], "steps": np.zeros(1)}
        x = _estimate(graph, x, arrays)
    past, U = "", len(arrays["middle"])
    if width := int(arrays.get("past_inputs", 0)) * U:
        memory["past"] = np.zeros(width)
        past = graph.input("past", width)
        x = graph("Concat", x, past, axis=1)
    inputs = _act(graph, x, arrays)
    for stage in STAGES:
        if f"{stage}.outputs" in arrays:
            inputs = _behind(graph, stage, x, inputs, arrays)
    graph.output("inputs", U, inputs)
    if past:
        recent = graph("Slice", past, np.array([0]), np.array([width - U]), np.array([1]))
        graph.output("next_past", width, graph("Concat", inputs, recent, axis=1))
    return graph.model(says), memory


def _seen(arrays: Mapping[str, np.ndarray]) -> int:
    """How many states the policy sees, past inputs included."""
    return len(arrays["lengthscales"]) - len(arrays["angles"])


def _act(graph: _Graph, x: str, arrays: Mapping[str, np.ndarray]) -> str:
    """middle + half_range tanh(exp(-|(z - c) / l|^2) w / squash) of states (batch, X)."""
    angles = arrays["angles"]
    z = graph("Gather", x, np.delete(np.arange(_seen(arrays)), angles), axis=1)
    if len(angles):
        turned = graph("Gather", x, angles, axis=1)
        z = graph("Concat", z, graph("Cos", turned), graph("Sin", turned), axis=1)
    apart = graph("Sub", graph("Unsqueeze", z, np.array([1])), arrays["centres"])
    apart = graph("Div", apart, arrays["lengthscales"])
    squares = graph("ReduceSum", graph("Mul", apart, apart), _ROW, keepdims=0)
    phi = graph("Exp", graph("Neg", squares))
    sums = graph("Div", graph("MatMul", phi, arrays["weights"]), arrays["squash"])
    within = graph("Mul", graph("Tanh", sums), arrays["half_range"])
    return graph("Add", within, arrays["middle"])


def _behind(
    graph: _Graph, stage: str, x: str, commands: str, arrays: Mapping[str, np.ndarray]
) -> str:
    """The results of a program of states and commands, node by node."""
    operations, first, second = (arrays[f"{stage}.{n}"] for n in ("operations", "first", "second"))
    widths = (x, _seen(arrays)), (commands, len(arrays["middle"]))
    registers: list[Any] = [
        graph("Gather", name, np.array([i]), axis=1) for name, width in widths for i in range(width)
    ]
    registers += [np.array([constant]) for constant in arrays[f"{stage}.constants"]]
    for operation, a, b in zip(operations, first, second, strict=True):
        operands = (registers[a], registers[b])[: 2 if operation < SINE else 1]
        registers.append(graph(OPERATORS[operation], *operands))
    return graph("Concat", *(registers[i] for i in arrays[f"{stage}.outputs"]), axis=1)


def _estimate(graph: _Graph, measured: str, arrays: Mapping[str, np.ndarray]) -> str:
    """x- + K (y - C x-) with the K of this step; the next x- is A times that."""
    A, C, gains = (arrays[f"estimator.{name}"] for name in ("A", "C", "gains"))
    expected, steps = graph.input("expected", len(A)), graph.input("steps", 1)
    last = np.array([len(gains) - 1.0])
    which = graph("Cast", graph("Min", steps, last), to=7)  # an int64
    K = graph("Gather", gains, graph("Squeeze", which, np.array([1])), axis=0)
    left = graph("Sub", measured, graph("MatMul", expected, C.T))
    change = graph("MatMul", K, graph("Unsqueeze", left, np.array([2])))
    estimate = graph("Add", expected, graph("Squeeze", change, np.array([2])))
    graph.output("next_expected", len(A), graph("MatMul", estimate, A.T))
    graph.output("next_steps", 1, graph("Add", steps, np.ones(1)))
    return estimate
