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
_HEAD: Final = 16
"""Channels of a head of the attention."""
_STAGES: Final = ((2, 0), (2, 0), (1, 2), (1, 2))
"""Of each stage: inverted residuals, EfficientViT modules."""


def build_efficientvit_b0(tensors: Tensors) -> bytes:
    """The ONNX file: `image` (N, 3, H, W) normalised RGB to `logits` (N, C, H / 8, W / 8), H and W multiples of 32.

    Raises ModelError where a tensor is missing, too many or not of the shape that the network needs.
    """
    network = _Builder(tensors)
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
        stem = "backbone.input_stem.op_list"
        x = self._swish(self._conv(x, f"{stem}.0", stride=2))
        x = self._add(x, self._separable(x, f"{stem}.1.main"))
        strides = {}
        for number, (residuals, modules) in enumerate(_STAGES):
            stage = f"backbone.stages.{number}.op_list"
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
        """Multi-scale linear attention: ReLU(Q) (ReLU(K)^T V), divided by ReLU(Q) times the sum of ReLU(K) (eq. 2)."""
        graph = self.graph
        qkv = self._conv(x, f"{name}.qkv")
        around, mixed = self._take(f"{name}.aggreg.0.0.weight"), self._take(f"{name}.aggreg.0.1.weight")
        nearby = self._convolution(qkv, around, None, len(around))
        nearby = self._convolution(nearby, mixed, None, len(mixed) // _HEAD)
        both = graph.node("Concat", qkv, nearby, axis=1)
        heads = 2 * len(self._take(f"{name}.qkv.conv.weight")) // (3 * _HEAD)
        by_head = graph.node("Reshape", both, graph.constant([0, heads, 3 * _HEAD, -1]))
        q, k, v = graph.nodes("Split", 3, by_head, graph.constant([_HEAD] * 3), axis=2)
        q, k = graph.node("Relu", q), graph.node("Relu", k)
        one = graph.constant(np.ones((), np.float32))
        v = graph.node("Pad", v, graph.constant([0, 0, 0, 0, 0, 0, 1, 0]), one)  # a row of ones, which sums the weights
        sums = graph.node("MatMul", graph.node("MatMul", v, graph.node("Transpose", k, perm=[0, 1, 3, 2])), q)
        weighed, weights = graph.nodes("Split", 2, sums, graph.constant([_HEAD, 1]), axis=2)
        safe = graph.node("Add", weights, graph.constant(np.array(_ATTENTION_EPSILON, np.float32)))
        mean = graph.node("Div", weighed, safe)
        size = graph.node("Shape", x, start=2)
        shape = graph.node("Concat", graph.constant([0, heads * _HEAD]), size, axis=0)
        return self._conv(graph.node("Reshape", mean, shape), f"{name}.proj")

    def _conv(self, x: str, name: str, stride: int = 1) -> str:
        """The convolution `name`, with the normalisation that follows it, if any."""
        weight = self._take(f"{name}.conv.weight").astype(np.float64)
        bias = self._take(f"{name}.conv.bias").astype(np.float64) if f"{name}.conv.bias" in self._tensors else None
        if f"{name}.norm.weight" in self._tensors:
            gain, offset, mean, variance = (
                self._take(f"{name}.norm.{part}").astype(np.float64) for part in ("weight", "bias", "running_mean", "running_var")
            )
            scale = gain / np.sqrt(variance + _NORM_EPSILON)
            weight = weight * scale[:, None, None, None]
            bias = offset + scale * ((0.0 if bias is None else bias) - mean)
        depthwise = weight.shape[1] == 1
        return self._convolution(x, weight, bias, len(weight) if depthwise else 1, stride)

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
        """Bicubic, half a pixel aligned by area, as R_v X R_h^T, R being the enlarged identity: Resize but for rounding.

        onnxruntime's Resize weighs all 16 neighbours of each value anew and takes as long as all convolutions.
        """
        graph = self.graph
        rows, columns = graph.nodes("Split", 2, graph.node("Shape", x, start=2), graph.constant([1, 1]), axis=0)
        R_v = self._enlarged_identity(rows, [1, 1, times, 1])
        R_h_transposed = self._enlarged_identity(columns, [1, 1, 1, times])
        return graph.node("MatMul", R_v, graph.node("MatMul", x, R_h_transposed))

    def _enlarged_identity(self, size: str, scales: list[int]) -> str:
        """(1, 1, size, size) identity, enlarged along one axis."""
        graph = self.graph
        square = graph.node("ConstantOfShape", graph.node("Concat", size, size, axis=0))
        one = graph.node("Unsqueeze", graph.node("EyeLike", square), graph.constant([0, 1]))
        return graph.node(
            "Resize", one, "", graph.constant(np.array(scales, np.float32)), mode="cubic", cubic_coeff_a=-0.75,
            coordinate_transformation_mode="pytorch_half_pixel",
        )  # fmt: skip

    def _take(self, name: str) -> NDArray[Any]:
        if name not in self._tensors:
            raise ModelError(f"has no tensor {name}", remedy="give the published weights of EfficientViT-B0 for segmentation")
        self._used.add(name)
        return self._tensors[name]
