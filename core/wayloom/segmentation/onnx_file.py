"""Inspection of an ONNX file without loading it: whether it holds a graph, and whether it refers to other files.

Field numbers are those of onnx.proto: ModelProto.graph 7; GraphProto.node 1, .initializer 5, .sparse_initializer 15;
NodeProto.attribute 5; AttributeProto.t 5, .g 6, .tensors 10, .graphs 11, .sparse_tensor 22; SparseTensorProto.values 1, .indices 2;
TensorProto.external_data 13, .data_location 14. FunctionProto (ModelProto.functions 25) holds nodes in field 7.
"""

from typing import Final

from wayloom.errors import ModelError
from wayloom.files.wire_format import BYTES, records

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
        has_graph = any(field == 7 and kind == BYTES for field, kind, _, _ in records(data, 0, len(data)))
        external = has_graph and _wants_other_files(data, 0, len(data), "model")
    except ValueError as error:
        raise ModelError("not an ONNX file", file=file, remedy="export the network to ONNX, weights inside") from error
    if not has_graph:
        raise ModelError("not an ONNX file: it holds no graph", file=file, remedy="export the network to ONNX, weights inside")
    if external:
        raise ModelError("keeps its weights in other files", file=file, remedy="save the network as one ONNX file, weights inside")


def _wants_other_files(data: bytes, start: int, end: int, message: str) -> bool:
    for field, kind, low, high in records(data, start, end):
        if message == "tensor" and (field == 13 or (field == 14 and low != 0)):
            return True
        inside = _INSIDE[message].get(field) if kind == BYTES else None
        if inside and _wants_other_files(data, low, high, inside):
            return True
    return False
