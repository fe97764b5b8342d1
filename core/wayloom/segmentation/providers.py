"""ONNX Runtime execution providers by device name."""

from typing import Final, get_args

import onnxruntime

from wayloom.errors import ModelError
from wayloom.segmentation.settings import Device

_PROVIDERS: Final = {
    "cuda": "CUDAExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "tensorrt": "TensorrtExecutionProvider",
    "cpu": "CPUExecutionProvider",
}
_AUTO: Final = ("cuda", "coreml", "openvino", "cpu")
"""The first that is there. TensorRT builds an engine for every size of image, for minutes: only who asks for it gets it."""


def available_devices() -> tuple[str, ...]:
    """The devices that this installation of onnxruntime has a provider for."""
    there = onnxruntime.get_available_providers()
    return tuple(device for device, provider in _PROVIDERS.items() if provider in there)


def resolved_device(device: str) -> str:
    """The device that is meant; for "auto" the first that is there. Raises ModelError for one that is unknown or not there."""
    there = available_devices()
    if device == "auto":
        return next(name for name in _AUTO if name in there)
    if device not in get_args(Device):
        raise ModelError(f"unknown device {device!r}", remedy=f"known are {', '.join(get_args(Device))}")
    if device not in there:
        raise ModelError(
            f"this onnxruntime has no provider for {device}, only for {', '.join(there)}",
            remedy="install the onnxruntime that has it (docs/labelling.md), or choose another device",
        )
    return device


def providers_of(device: str) -> list[str]:
    """onnxruntime's names: the device's own provider, then the CPU's for what it cannot do."""
    return list(dict.fromkeys([_PROVIDERS[device], _PROVIDERS["cpu"]]))
