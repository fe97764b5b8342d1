"""Semantic segmentation of images: the catalogue of networks, inference, class scores; the only import of onnxruntime."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # onnxruntime reads it when it is imported; nothing is recorded or sent unasked
