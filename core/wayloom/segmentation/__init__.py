"""Image to class: the catalogue of networks and the only import of onnxruntime."""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")  # onnxruntime reads it when it is imported; nothing is recorded or sent unasked
