"""EfficientViT-B0 for semantic segmentation as an ONNX graph of its published weights.

Cai, Li, Hu, Gan, Han: EfficientViT: Multi-Scale Linear Attention for High-Resolution Dense Prediction, ICCV 2023.

    stride 2   stem: convolution, depthwise separable block      8 channels
    stride 4   2 inverted residuals                             16
    stride 8   2 inverted residuals                             32 ─────────────┐
    stride 16  1 inverted residual, 2 EfficientViT modules      64 ──────┐      │
    stride 32  1 inverted residual, 2 EfficientViT modules     128 ──┐   │      │
    head       each to 32 channels at stride 8 (bicubic), added  ────┴───┴──────┘
               1 inverted residual, 1x1 to 128, 1x1 to the classes

An EfficientViT module is multi-scale linear attention (sec. 3.1: eq. 2 with ReLU as the kernel, over heads of 16 channels at two
scales) and then an inverted residual, each added to its input. Batch normalisation is folded into the convolutions in float64.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ModelError
from wayloom.segmentation.conversion.onnx_writer import GraphWriter
from wayloom.segmentation.conversion.state_dict import Tensors

_NORM_EPSILON: Final = 1e-5
_ATTENTION_EPSILON: Final = 1e-15
_KEYS: Final = -0.75
"""a of the bicubic kernel, as PyTorch has it."""
_HEAD: Final = 16
"""Channels of a head of the attention."""
_STAGES: Final = ((2, 0), (2, 0), (1, 2), (1, 2))
"""Of each stage: inverted residuals, EfficientViT modules."""
_STEM: Final = "backbone.input_stem.op_list."
_STAGE: Final = "backbone.stages."
_BLOCK: Final = 16
"""onnxruntime's CPU convolutions keep channels in blocks of so many, and reorder what fills none to and fro."""


def build_efficientvit_b0(tensors: Tensors) -> bytes:
    """The ONNX file: `image` (N, 3, H, W) normalised RGB to `logits` (N, C, H / 8, W / 8), H and W multiples of 32.

    Raises ModelError where a tensor is missing, too many or not of the shape that the network needs.
    """
    network = _Builder(_in_whole_blocks(tensors))
    coarse = network.features("image")
    logits = network.head(coarse)
    network.check_all_used()
    classes = len(tensors["head.output_ops.0.op_list.1.conv.bias"])
    network.graph.name_output(logits, "logits")
    return network.graph.model(
        {"image": ("count", 3, "height", "width")}, {"logits": ("count", classes, "rows", "columns")}, "efficientvit_seg_b0"
    )


class _Builder:
    """Writes the network's parts; each takes the name of its input and gives the name of its output."""

    def __init__(self, tensors: Tensors) -> None:
        self.graph = GraphWriter()
        self._tensors = tensors
        self._used: set[str] = set()

    def features(self, x: str) -> dict[int, str]:
        """The backbone: the outputs of the last three stages, by their stride."""
        x = self._swish(self._conv(x, f"{_STEM}0", stride=2))
        x = self._add(x, self._separable(x, f"{_STEM}1.main"))
        strides = {}
        for number, (residuals, modules) in enumerate(_STAGES):
            stage = f"{_STAGE}{number}.op_list"
            x = self._residual(x, f"{stage}.0.main", stride=2)
            for k in range(1, residuals):
                x = self._add(x, self._residual(x, f"{stage}.{k}.main"))
            for k in range(residuals, residuals + modules):
                x = self._add(x, self._attention(x, f"{stage}.{k}.context_module.main"))
                x = self._add(x, self._residual(x, f"{stage}.{k}.local_module.main"))
            strides[4 * 2**number] = x
        return strides

    def head(self, features: dict[int, str]) -> str:
        """Logits at stride 8 from the features at strides 32, 16 and 8."""
        x = self._enlarged(self._conv(features[32], "head.input_ops.0.op_list.0"), 4)
        x = self._add(x, self._enlarged(self._conv(features[16], "head.input_ops.1.op_list.0"), 2))
        x = self._add(x, self._conv(features[8], "head.input_ops.2"))
        x = self._add(x, self._residual(x, "head.middle.op_list.0.main"))
        x = self._swish(self._conv(x, "head.output_ops.0.op_list.0"))
        return self._conv(x, "head.output_ops.0.op_list.1")

    def check_all_used(self) -> None:
        """Raises ModelError where the file holds tensors of another network."""
        left = sorted(name for name in set(self._tensors) - self._used if not name.endswith("num_batches_tracked"))
        if left:
            raise ModelError(
                f"{len(left)} tensors are no part of EfficientViT-B0, the first is {left[0]}", remedy="give the weights of B0"
            )

    def _residual(self, x: str, name: str, stride: int = 1) -> str:
        """Inverted residual: widen by 1x1, look around by a depthwise 3x3, narrow by 1x1."""
        x = self._swish(self._conv(x, f"{name}.inverted_conv"))
        x = self._swish(self._conv(x, f"{name}.depth_conv", stride=stride))
        return self._conv(x, f"{name}.point_conv")

    def _separable(self, x: str, name: str) -> str:
        return self._conv(self._swish(self._conv(x, f"{name}.depth_conv")), f"{name}.point_conv")

    def _attention(self, x: str, name: str) -> str:
        """Multi-scale linear attention: the heads at x's own scale and those of what lies around each pixel, mixed by 1x1."""
        own, _ = self._folded(f"{name}.qkv")
        around, mixed = self._take(f"{name}.aggreg.0.0.weight"), self._take(f"{name}.aggreg.0.1.weight")
        here, near = [], []
        for part in range(3):  # channels are Q, K, V of one head after the other's: convolutions by part leave nothing to cut
            channels = np.arange(len(own)).reshape(-1, 3, _HEAD)[:, part].ravel()
            here.append(self._convolution(x, own[channels], None, 1))
            look = self._convolution(here[part], around[channels], None, len(channels))
            near.append(self._convolution(look, mixed[channels], None, len(channels) // _HEAD))
        size = self.graph.node("Shape", x, start=2)
        weight, bias = self._folded(f"{name}.proj")
        half = weight.shape[1] // 2
        of_here = self._convolution(self._attended(here, half, size), weight[:, :half], bias, 1)
        return self._add(of_here, self._convolution(self._attended(near, half, size), weight[:, half:], None, 1))

    def _attended(self, qkv: list[str], channels: int, size: str) -> str:
        """Linear attention over the whole image: V ReLU(K)^T ReLU(Q), divided by the sum of ReLU(K) times ReLU(Q) (eq. 2)."""
        graph = self.graph
        by_head = graph.constant([0, channels // _HEAD, _HEAD, -1])
        q, k = (graph.node("Reshape", graph.node("Relu", x), by_head) for x in qkv[:2])
        v = graph.node("Reshape", qkv[2], by_head)
        K_transposed = graph.node("Transpose", k, perm=[0, 1, 3, 2])
        weights = graph.node("MatMul", graph.node("ReduceSum", K_transposed, graph.constant([2]), keepdims=1), q)
        sums = graph.node("MatMul", graph.node("MatMul", v, K_transposed), q)
        mean = graph.node("Div", sums, graph.node("Add", weights, graph.constant(np.array(_ATTENTION_EPSILON, np.float32))))
        return graph.node("Reshape", mean, graph.node("Concat", graph.constant([0, channels]), size, axis=0))

    def _conv(self, x: str, name: str, stride: int = 1) -> str:
        """The convolution `name`, with the normalisation that follows it, if any."""
        weight, bias = self._folded(name)
        return self._convolution(x, weight, bias, len(weight) if weight.shape[1] == 1 else 1, stride)

    def _folded(self, name: str) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """Weights (outputs, inputs / groups, h, w) and bias, float64, of the convolution `name` and its normalisation."""
        weight = self._take(f"{name}.conv.weight").astype(np.float64)
        bias = self._take(f"{name}.conv.bias").astype(np.float64) if f"{name}.conv.bias" in self._tensors else None
        if f"{name}.norm.weight" in self._tensors:
            gain, offset, mean, variance = (
                self._take(f"{name}.norm.{part}").astype(np.float64) for part in ("weight", "bias", "running_mean", "running_var")
            )
            scale = gain / np.sqrt(variance + _NORM_EPSILON)
            weight = weight * scale[:, None, None, None]
            bias = offset + scale * ((0.0 if bias is None else bias) - mean)
        return weight, bias

    def _convolution(self, x: str, weight: NDArray[Any], bias: NDArray[Any] | None, groups: int, stride: int = 1) -> str:
        """A convolution whose output has the input's size over the stride."""
        size = weight.shape[2]
        inputs = [x, self.graph.constant(weight.astype(np.float32))]
        if bias is not None:
            inputs.append(self.graph.constant(bias.astype(np.float32)))
        return self.graph.node(
            "Conv", *inputs, group=groups, kernel_shape=[size, size], pads=[size // 2] * 4, strides=[stride, stride]
        )

    def _swish(self, x: str) -> str:
        return self.graph.node("HardSwish", x)

    def _add(self, x: str, y: str) -> str:
        return self.graph.node("Add", x, y)

    def _enlarged(self, x: str, times: int) -> str:
        """Bicubic, half a pixel aligned by area, as R_v X R_h^T, R weighing the neighbours of each place: Resize but for rounding.

        onnxruntime's Resize weighs all 16 neighbours of each value anew and takes as long as all convolutions.
        """
        graph = self.graph
        rows, columns = graph.nodes("Split", 2, graph.node("Shape", x, start=2), graph.constant([1, 1]), axis=0)
        R_h_transposed = graph.node("Transpose", self._enlarging(columns, times), perm=[1, 0])
        return graph.node("MatMul", self._enlarging(rows, times), graph.node("MatMul", x, R_h_transposed))

    def _enlarging(self, size: str, times: int) -> str:
        """(times * size, size) matrix: each row weighs four neighbours; those beyond the border are the border itself."""
        graph = self.graph
        offsets, weights = _cubic_taps(times)
        zero, one = graph.constant(np.array(0)), graph.constant(np.array(1))
        count = graph.node("Squeeze", size)
        pixels = graph.node("Reshape", graph.node("Range", zero, count, one), graph.constant([-1, 1, 1]))
        taps = graph.node("Add", pixels, graph.constant(offsets))
        taps = graph.node("Clip", taps, zero, graph.node("Sub", count, one))
        ones = graph.node("OneHot", taps, size, graph.constant(np.array([0, 1], np.float32)))  # (size, times, 4, size)
        rows = graph.node("MatMul", graph.constant(weights[:, None].astype(np.float32)), ones)
        return graph.node("Reshape", rows, graph.node("Concat", graph.constant([-1]), size, axis=0))

    def _take(self, name: str) -> NDArray[Any]:
        if name not in self._tensors:
            raise ModelError(f"has no tensor {name}", remedy="give the published weights of EfficientViT-B0 for segmentation")
        self._used.add(name)
        return self._tensors[name]


def _cubic_taps(times: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Bicubic convolution (Keys 1981, a = -0.75) at each of the `times` places that a pixel becomes.

    returns (times, 4) offsets of the neighbours from that pixel, (times, 4) their weights
    """
    place = ((np.arange(times) + 0.5) / times - 0.5)[:, None]
    offsets = np.floor(place) + np.arange(-1, 3)
    d = np.abs(place - offsets)
    near = ((_KEYS + 2) * d - (_KEYS + 3)) * d * d + 1
    far = _KEYS * (((d - 5) * d + 8) * d - 4)
    return offsets.astype(np.int64), np.where(d <= 1, near, far)


def _in_whole_blocks(tensors: Tensors) -> Tensors:
    """The tensors with the 8 channels of the stem filled up by 8 of zeros, which stay zero: normalised by gain 0, offset 0."""
    eight = (_STEM, f"{_STAGE}0.op_list.0.main.inverted_conv.")
    return {name: _filled_up(values) if name.startswith(eight) else values for name, values in tensors.items()}


def _filled_up(values: NDArray[Any]) -> NDArray[Any]:
    shape = [_BLOCK if length == _BLOCK // 2 else length for length in values.shape]
    filled = np.zeros(shape, values.dtype)
    filled[tuple(slice(length) for length in values.shape)] = values
    return filled
