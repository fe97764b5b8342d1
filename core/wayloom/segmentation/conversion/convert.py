"""Conversion of one file of published weights to an ONNX file with its description."""

import hashlib
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wayloom.config.extras import from_extra
from wayloom.config.toml_text import toml_text
from wayloom.errors import ModelError
from wayloom.files.atomic import write_atomically
from wayloom.segmentation.conversion.state_dict import Tensors, read_state_dict
from wayloom.segmentation.description import read_description
from wayloom.segmentation.network import Network


@dataclass(frozen=True, slots=True)
class Conversion:
    """How the weights of one kind of network become ONNX: build() gives what makes the file; the rest is its description."""

    build: Callable[[], Callable[[Tensors], bytes]]
    title: str
    licence: str
    source: str
    multiple: int
    zoom: float


def _efficientvit_b0() -> Callable[[Tensors], bytes]:
    """Raises MissingExtraError where the package onnx is not installed: only who converts needs it."""
    with from_extra("convert", "the conversion of a network"):
        from wayloom.segmentation.conversion.efficientvit import build_efficientvit_b0
    return build_efficientvit_b0


CONVERSIONS: Final[dict[str, Conversion]] = {
    "efficientvit-b0": Conversion(
        _efficientvit_b0,
        title="EfficientViT-B0 (Cai et al., ICCV 2023), made ONNX by `wayloom models convert`; colour",
        licence="Apache-2.0 (trained on Cityscapes, whose own terms are for non-commercial research)",
        source="han-cai/efficientvit-seg on Hugging Face, by the authors at mit-han-lab",
        multiple=32,
        zoom=1.25,  # trained on frames of 2048 x 1024: smaller ones are better enlarged
    )
}


def builder_of(name: str) -> Callable[[Tensors], bytes]:
    """What makes an ONNX file of the weights of a network.

    Raises ModelError for an unknown name, MissingExtraError without the package onnx.
    """
    if name not in CONVERSIONS:
        raise ModelError(f"cannot convert {name!r}", remedy=f"known are {', '.join(CONVERSIONS)}")
    return CONVERSIONS[name].build()


def convert(name: str, weights: Path, out: Path) -> Path:
    """Write the ONNX file `out` and its TOML beside it, and return the TOML's path. The same weights give the same bytes.

    The network is loaded and tried before anything is put in place.
    Raises ModelError for an unknown name, for weights that are not this network's, and where `out` is no .onnx file;
    MissingExtraError without the package onnx.
    """
    build = builder_of(name)
    if out.suffix != ".onnx":
        raise ModelError("is no name of an ONNX file", file=out, remedy="end it in .onnx")
    if not out.parent.is_dir():
        raise ModelError("no such folder", file=out.parent, remedy="make it first")
    try:
        data = build(read_state_dict(weights))
    except ModelError as error:
        raise error if error.file else ModelError(str(error), file=weights) from error
    toml = out.with_suffix(".toml")
    text = _description(CONVERSIONS[name], out, hashlib.sha256(data).hexdigest())
    _try_out(data, text, out.name)
    write_atomically(out, data)
    write_atomically(toml, text.encode())
    return toml


def _try_out(data: bytes, text: str, file: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / file).write_bytes(data)
        toml = Path(folder) / (file.removesuffix(".onnx") + ".toml")
        toml.write_text(text, encoding="utf-8")
        Network(read_description(toml))


def _description(kind: Conversion, out: Path, digest: str) -> str:
    stem = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in out.stem).lstrip("._-") or "network"
    return f'''name = "{stem}"
title = "{kind.title}"
file = {toml_text(out.name)}
sha256 = "{digest}"
licence = "{kind.licence}"
source = "{kind.source}"
layout = "NCHW"
dtype = "float32"
mean = [0.485, 0.456, 0.406]
std = [0.229, 0.224, 0.225]
size = "dynamic"
multiple = {kind.multiple}
zoom = {kind.zoom}
output = "logits"
colour = true
'''
