"""The small network that the package ships: classes of street scenes, for one CPU core.

    stride 2   stem 16
    stride 4   2 blocks of 32 channels   ────────────────┐
    stride 8   3 blocks of 64            ──────────┐     │
    stride 16  5 blocks of 112, dilated  ────┐     │     │
    stride 32  3 blocks of 144, dilated, + strip context │
               upsample, add ────────────────┘     │     │
               upsample, add ──────────────────────┘     │
               upsample, add ────────────────────────────┘
    stride 4   3x3 convolution, 19 logits

A block widens by 1x1, looks around by a depthwise 3x3, narrows by 1x1 and adds itself to its input. The strip context averages each
row and each column of the coarsest grid, so that a pixel knows how high in the picture it is and what stands in its column,
whatever the picture's width. Fully convolutional: height and width must be multiples of 32.
"""

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from wayloom.config.classes import CLASS_COUNT


def conv(inputs: int, outputs: int, size: int, stride: int = 1, dilation: int = 1, groups: int = 1) -> nn.Sequential:
    """Convolution and batch normalisation, size kept but for the stride."""
    padding = dilation * (size // 2)
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, padding, dilation, groups, bias=False),
        nn.BatchNorm2d(outputs),
    )


class Block(nn.Module):
    """Inverted residual: widen, look around, narrow; added to the input where the shapes agree."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, dilation: int = 1, widen: int = 2) -> None:
        super().__init__()
        wide = inputs * widen
        self.widen = conv(inputs, wide, 1)
        self.look = conv(wide, wide, 3, stride, dilation, groups=wide)
        self.narrow = conv(wide, outputs, 1)
        self.residual = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        y = F.relu(self.widen(x))
        y = F.relu(self.look(y))
        y = self.narrow(y)
        return x + y if self.residual else y


class StripContext(nn.Module):
    """Adds what the mean of each row and of each column says."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.row = conv(channels, channels, 1)
        self.column = conv(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        return x + F.relu(self.row(x.mean(3, keepdim=True)) + self.column(x.mean(2, keepdim=True)))


class CityNetwork(nn.Module):
    """(N, 3, H, W) normalised RGB to (N, 19, H / 4, W / 4) logits."""

    def __init__(self) -> None:
        super().__init__()
        self.stem = conv(3, 16, 3, 2)
        self.to4 = nn.Sequential(Block(16, 32, 2, widen=3), Block(32, 32))
        self.to8 = nn.Sequential(Block(32, 64, 2, widen=3), Block(64, 64), Block(64, 64))
        self.to16 = nn.Sequential(Block(64, 112, 2, widen=3), *(Block(112, 112, dilation=d) for d in (1, 2, 1, 2)))
        self.to32 = nn.Sequential(Block(112, 144, 2, widen=2), *(Block(144, 144, dilation=d) for d in (2, 4)), StripContext(144))
        self.from32 = conv(144, 112, 1)
        self.from16 = conv(112, 64, 1)
        self.from8 = conv(64, 32, 1)
        self.mix16 = Block(112, 112)
        self.mix8 = Block(64, 64)
        self.mix4 = nn.Sequential(conv(32, 48, 3), nn.ReLU())
        self.logits = nn.Conv2d(48, CLASS_COUNT, 1)

    def forward(self, x: Tensor) -> Tensor:
        s4 = self.to4(F.relu(self.stem(x)))
        s8 = self.to8(s4)
        s16 = self.to16(s8)
        s32 = self.to32(s16)
        y = self.mix16(s16 + twice(self.from32(s32)))
        y = self.mix8(s8 + twice(self.from16(y)))
        y = self.mix4(s4 + twice(self.from8(y)))
        logits: Tensor = self.logits(y)
        return logits


def twice(x: Tensor) -> Tensor:
    """Bilinear upsampling by 2."""
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)


def export_onnx(network: CityNetwork, path: str) -> None:
    """One ONNX file, weights inside, batch normalisation folded, height and width dynamic."""
    network.eval()
    torch.onnx.export(
        network,
        (torch.zeros(1, 3, 192, 704),),
        path,
        dynamo=False,
        opset_version=17,
        input_names=["image"],
        output_names=["logits"],
        dynamic_axes={"image": {2: "height", 3: "width"}, "logits": {2: "rows", 3: "columns"}},
    )
