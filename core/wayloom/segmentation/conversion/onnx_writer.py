"""ONNX graphs, node by node, by the package onnx of the extra `convert`: the same graph and weights give the same bytes."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from onnx import (
    AttributeProto,
    GraphProto,
    ModelProto,
    NodeProto,
    OperatorSetIdProto,
    TensorProto,
    ValueInfoProto,
    checker,
    helper,
)

Dimension = int | str
Attribute = int | float | str | Sequence[int]

IR_VERSION: Final = 8
OPSET: Final = 17


class GraphWriter:
    """Collects nodes and constants; values are known by their names, which are numbered in the order of their making."""

    def __init__(self) -> None:
        self._nodes: list[NodeProto] = []
        self._constants: list[TensorProto] = []
        self._made = 0

    def constant(self, values: NDArray[Any] | Sequence[int]) -> str:
        """The name of a constant: float32 or int64; a list of int is a vector of int64."""
        array = np.asarray(values, np.int64) if not isinstance(values, np.ndarray) else np.asarray(values, order="C")
        name = self._new("c")
        kind = helper.np_dtype_to_tensor_dtype(array.dtype)
        little = array.astype(array.dtype.newbyteorder("<"))
        self._constants.append(TensorProto(dims=array.shape, data_type=kind, name=name, raw_data=little.tobytes()))
        return name

    def node(self, kind: str, *inputs: str, **attributes: Attribute) -> str:
        """Add an operator of one output and return the output's name. An input that is left out is ''."""
        return self.nodes(kind, 1, *inputs, **attributes)[0]

    def nodes(self, kind: str, outputs: int, *inputs: str, **attributes: Attribute) -> list[str]:
        """Add an operator of several outputs and return their names."""
        names = [self._new("v") for _ in range(outputs)]
        self._nodes.append(_operator(kind, inputs, names, attributes))
        return names

    def name_output(self, value: str, name: str) -> None:
        """Give a value the name under which `model` lists it."""
        self._nodes.append(_operator("Identity", [value], [name], {}))

    def model(self, inputs: dict[str, Sequence[Dimension]], outputs: dict[str, Sequence[Dimension]], name: str) -> bytes:
        """The file, checked. inputs, outputs: name to shape, all float32; a dimension with a name may have any length."""
        graph = GraphProto(
            node=self._nodes, name=name, initializer=self._constants,
            input=[_value(*item) for item in inputs.items()], output=[_value(*item) for item in outputs.items()],
        )  # fmt: skip
        opset = OperatorSetIdProto(domain="", version=OPSET)
        made = ModelProto(ir_version=IR_VERSION, producer_name="wayloom", graph=graph, opset_import=[opset])
        checker.check_model(made)
        return bytes(made.SerializeToString(deterministic=True))

    def _new(self, letter: str) -> str:
        self._made += 1
        return f"{letter}{self._made}"


def _operator(kind: str, inputs: Sequence[str], names: Sequence[str], attributes: dict[str, Attribute]) -> NodeProto:
    made: list[AttributeProto] = [helper.make_attribute(name, value) for name, value in sorted(attributes.items())]
    return NodeProto(input=inputs, output=names, op_type=kind, attribute=made)


def _value(name: str, shape: Sequence[Dimension]) -> ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
