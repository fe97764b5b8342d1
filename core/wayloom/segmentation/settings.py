"""Settings of the segmentation."""

from typing import Literal

from pydantic import Field

from wayloom.config.settings import Settings

Device = Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml"]


class SegmentationSettings(Settings):
    """Which network labels the images, and on what it runs."""

    model: str | None = Field(
        None,
        description="network: a name of `wayloom models`, or a TOML or ONNX file; default the built-in one",
        json_schema_extra={"variable": "WAYLOOM_MODEL", "file": True},
    )
    device: Device = Field(
        "auto",
        description="on what the network runs; auto: the first of CUDA, CoreML, OpenVINO, CPU that is there",
        json_schema_extra={"variable": "WAYLOOM_DEVICE"},
    )
