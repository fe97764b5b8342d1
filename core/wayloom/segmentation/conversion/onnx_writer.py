"""Writer of ONNX files: the same graph and weights give the same bytes on every machine.

Protocol buffers' wire format and onnx.proto's field numbers, as in `wayloom.segmentation.onnx_file`, which reads them.
ModelProto: ir_version 1, producer_name 2, graph 7, opset_import 8. GraphProto: node 1, name 2, initializer 5, input 11, output 12.
NodeProto: input 1, output 2, op_type 4, attribute 5. AttributeProto: name 1, f 2, i 3, s 4, ints 8, type 20.
TensorProto: dims 1, data_type 2, name 8, raw_data 9.
"""

import struct
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Dimension = int | str
Attribute = int | float | str | Sequence[int]

IR_VERSION: Final = 8
OPSET: Final = 17
_FLOAT: Final = 1
_ELEMENT_TYPES: Final = {np.dtype(np.float32): _FLOAT, np.dtype(np.int64): 7}


class GraphWriter:
    """Collects nodes and constants; values are known by their names, which are numbered in the order of their making."""

    def __init__(self) -> None:
        self._nodes: list[bytes] = []
        self._constants: list[bytes] = []
        self._made = 0

    def constant(self, values: NDArray[Any] | Sequence[int]) -> str:
        """The name of a constant: float32 or int64; a list of int is a vector of int64."""
        array = np.asarray(values, np.int64) if not isinstance(values, np.ndarray) else np.ascontiguousarray(values)
        name = self._new("c")
        little = array.astype(array.dtype.newbyteorder("<"))
        dims = b"".join(_number(1, n) for n in array.shape)
        kind = _number(2, _ELEMENT_TYPES[array.dtype])
        self._constants.append(_nested(5, dims + kind + _text(8, name) + _nested(9, little.tobytes())))
        return name

    def node(self, kind: str, *inputs: str, **attributes: Attribute) -> str:
        """Add an operator of one output and return the output's name. An input that is left out is ''."""
        name = self._new("v")
        self._record(kind, inputs, [name], attributes)
        return name

    def nodes(self, kind: str, outputs: int, *inputs: str, **attributes: Attribute) -> list[str]:
        """Add an operator of several outputs and return their names."""
        names = [self._new("v") for _ in range(outputs)]
        self._record(kind, inputs, names, attributes)
        return names

    def name_output(self, value: str, name: str) -> None:
        """Give a value the name under which `model` lists it."""
        self._record("Identity", [value], [name], {})

    def _record(self, kind: str, inputs: Sequence[str], names: Sequence[str], attributes: Mapping[str, Attribute]) -> None:
        parts = [_text(1, name) for name in inputs] + [_text(2, name) for name in names] + [_text(4, kind)]
        parts += [_nested(5, _attribute(name, value)) for name, value in sorted(attributes.items())]
        self._nodes.append(_nested(1, b"".join(parts)))

    def model(self, inputs: dict[str, Sequence[Dimension]], outputs: dict[str, Sequence[Dimension]], name: str) -> bytes:
        """The file. inputs, outputs: name to shape, all float32; a dimension with a name may have any length."""
        ends = [_nested(11, _value(*item)) for item in inputs.items()] + [_nested(12, _value(*item)) for item in outputs.items()]
        graph = b"".join([*self._nodes, _text(2, name), *self._constants, *ends])
        opset = _nested(8, _text(1, "") + _number(2, OPSET))
        return _number(1, IR_VERSION) + _text(2, "wayloom") + _nested(7, graph) + opset

    def _new(self, letter: str) -> str:
        self._made += 1
        return f"{letter}{self._made}"


def _attribute(name: str, value: Attribute) -> bytes:
    if isinstance(value, int):
        return _text(1, name) + _number(3, value) + _number(20, 2)
    if isinstance(value, float):
        return _text(1, name) + _varint(2 << 3 | 5) + struct.pack("<f", value) + _number(20, 1)
    if isinstance(value, str):
        return _text(1, name) + _text(4, value) + _number(20, 3)
    return _text(1, name) + b"".join(_number(8, n) for n in value) + _number(20, 7)


def _value(name: str, shape: Sequence[Dimension]) -> bytes:
    dims = b"".join(_nested(1, _number(1, d) if isinstance(d, int) else _text(2, d)) for d in shape)
    return _text(1, name) + _nested(2, _nested(1, _number(1, _FLOAT) + _nested(2, dims)))


def _varint(value: int) -> bytes:
    value &= 2**64 - 1  # a negative number is its complement of two in 64 bits
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _nested(field: int, data: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def _text(field: int, text: str) -> bytes:
    return _nested(field, text.encode())
