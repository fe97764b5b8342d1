"""Inspection of an ONNX file without loading it: whether it holds a graph, and whether it refers to other files.

Protocol buffers' wire format: a record is a key (field << 3 | type) and a value; types 0 varint, 1 eight bytes, 2 length and bytes,
5 four bytes. Field numbers are those of onnx.proto: ModelProto.graph 7; GraphProto.node 1, .initializer 5, .sparse_initializer 15;
NodeProto.attribute 5; AttributeProto.t 5, .g 6, .tensors 10, .graphs 11, .sparse_tensor 22; SparseTensorProto.values 1, .indices 2;
TensorProto.external_data 13, .data_location 14. FunctionProto (ModelProto.functions 25) holds nodes in field 7.
"""

from collections.abc import Iterator
from typing import Final

from wayloom.errors import ModelError

_BYTES: Final = 2
# Where a message of each kind holds messages of another kind: {kind: {field: kind}}.
_INSIDE: Final[dict[str, dict[int, str]]] = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {},
}


def check_onnx(data: bytes, file: str) -> None:
    """Raises ModelError where `data` is no ONNX model or keeps weights in other files."""
    try:
        has_graph = any(field == 7 and kind == _BYTES for field, kind, _, _ in _records(data, 0, len(data)))
        external = has_graph and _wants_other_files(data, 0, len(data), "model")
    except ValueError as error:
        raise ModelError("not an ONNX file", file=file, remedy="export the network to ONNX, weights inside") from error
    if not has_graph:
        raise ModelError("not an ONNX file: it holds no graph", file=file, remedy="export the network to ONNX, weights inside")
    if external:
        raise ModelError("keeps its weights in other files", file=file, remedy="save the network as one ONNX file, weights inside")


def _wants_other_files(data: bytes, start: int, end: int, message: str) -> bool:
    for field, kind, low, high in _records(data, start, end):
        if message == "tensor" and (field == 13 or (field == 14 and low != 0)):
            return True
        inside = _INSIDE[message].get(field) if kind == _BYTES else None
        if inside and _wants_other_files(data, low, high, inside):
            return True
    return False


def _records(data: bytes, start: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """(field, type, low, high): the place of the bytes, or (value, value) of a varint. Raises ValueError off the format."""
    at = start
    while at < end:
        key, at = _varint(data, at, end)
        field, kind = key >> 3, key & 7
        if kind == 0:
            value, at = _varint(data, at, end)
            yield field, kind, value, value
            continue
        if kind == _BYTES:
            size, at = _varint(data, at, end)
        elif kind in (1, 5):
            size = 8 if kind == 1 else 4
        else:
            raise ValueError(f"wire type {kind}")
        if field == 0 or at + size > end:
            raise ValueError("record runs over its end")
        yield field, kind, at, at + size
        at += size


def _varint(data: bytes, at: int, end: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= end:
            raise ValueError("varint runs over its end")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("varint too long")
