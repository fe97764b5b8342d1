"""Tiny ONNX networks, written byte by byte, for the tests: a class for each colour, and every way to be wrong."""

from pathlib import Path

import numpy as np

from wayloom.files import wire_format
from wayloom.files.wire_format import number_field as number

FLOAT, UINT8, INT64 = 1, 2, 7
Dim = int | str


def nested(field: int, *parts: bytes | str) -> bytes:
    return wire_format.field(field, b"".join(p.encode() if isinstance(p, str) else p for p in parts))


def tensor(name: str, values: np.ndarray, *more: bytes) -> bytes:
    kind = {np.dtype(np.float32): FLOAT, np.dtype(np.int64): INT64}[values.dtype]
    return b"".join([*(number(1, n) for n in values.shape), number(2, kind), nested(8, name), nested(9, values.tobytes()), *more])


def node(kind: str, inputs: list[str], output: str, *attributes: bytes) -> bytes:
    return b"".join(
        [*(nested(1, name) for name in inputs), nested(2, output), nested(4, kind), *(nested(5, a) for a in attributes)]
    )


def integer(name: str, value: int) -> bytes:
    return nested(1, name) + number(3, value) + number(20, 2)


def integers(name: str, *values: int) -> bytes:
    return nested(1, name) + b"".join(number(8, v) for v in values) + number(20, 7)


def value(name: str, kind: int, *shape: Dim) -> bytes:
    dims = b"".join(nested(1, number(1, d) if isinstance(d, int) else nested(2, d)) for d in shape)
    return nested(1, name) + nested(2, nested(1, number(1, kind), nested(2, dims)))


def model(nodes: list[bytes], tensors: list[bytes], inputs: list[bytes], outputs: list[bytes]) -> bytes:
    graph = b"".join(
        [
            *(nested(1, n) for n in nodes),
            nested(2, "made"),
            *(nested(5, t) for t in tensors),
            *(nested(11, i) for i in inputs),
            *(nested(12, o) for o in outputs),
        ]
    )
    return number(1, 8) + nested(7, graph) + nested(8, nested(1, ""), number(2, 17))


def colour_weights(classes: int) -> np.ndarray:
    """(classes, 3, 1, 1): the first three classes are red, green and blue, the others never win."""
    weights = np.full((classes, 3, 1, 1), -1, np.float32)
    for c in range(min(3, classes)):
        weights[c, c] = 2.0
    return weights


def logits_network(classes: int = 3, pool: int = 1, *, external: bool = False, count: Dim = 1) -> bytes:
    """float32 NCHW of any size to logits at stride `pool`; `count` images at once."""
    more = (nested(13, nested(1, "location"), nested(2, "weights.bin")), number(14, 1)) if external else ()
    steps = [node("Conv", ["image", "w"], "raw")]
    pooling = (integers("kernel_shape", pool, pool), integers("strides", pool, pool))
    steps.append(node("AveragePool", ["raw"], "logits", *pooling))
    return model(
        steps,
        [tensor("w", colour_weights(classes), *more)],
        [value("image", FLOAT, count, 3, "h", "w")],
        [value("logits", FLOAT, count, classes, "gh", "gw")],
    )


def ids_network(side: int, classes: int = 3) -> bytes:
    """uint8 NHWC of one size to the arg max."""
    steps = [
        node("Cast", ["image"], "f", integer("to", FLOAT)),
        node("Transpose", ["f"], "t", integers("perm", 0, 3, 1, 2)),
        node("Conv", ["t", "w"], "logits"),
        node("ArgMax", ["logits"], "ids", integer("axis", 1), integer("keepdims", 0)),
    ]
    return model(
        steps,
        [tensor("w", colour_weights(classes))],
        [value("image", UINT8, 1, side, side, 3)],
        [value("ids", INT64, 1, side, side)],
    )


def ids_of_any_size() -> bytes:
    """float32 NCHW of any size to the arg max of each pixel."""
    steps = [node("Conv", ["image", "w"], "logits"), node("ArgMax", ["logits"], "ids", integer("axis", 1), integer("keepdims", 0))]
    return model(
        steps,
        [tensor("w", colour_weights(3))],
        [value("image", FLOAT, 1, 3, "h", "w")],
        [value("ids", INT64, 1, "h", "w")],
    )


def put(folder: Path, name: str, data: bytes, toml: str) -> Path:
    """Write NAME.onnx and NAME.toml; the TOML's path."""
    (folder / f"{name}.onnx").write_bytes(data)
    path = folder / f"{name}.toml"
    path.write_text(toml)
    return path


PLAIN = "mean = [0.0, 0.0, 0.0]\nstd = [1.0, 1.0, 1.0]\n"
"""No normalisation but the scale."""
THREE = PLAIN + "classes = [13, 8, 10]\nmultiple = 8\n"
"""Red is car, green is vegetation, blue is sky."""
IDS = 'classes = [13, 8, 255]\nlayout = "NHWC"\ndtype = "uint8"\noutput = "ids"\nsize = "tiles"\ntile_px = 64\n'
"""Red is car, green is vegetation, blue is void; squares of 64 pixels."""
