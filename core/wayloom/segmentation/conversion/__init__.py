"""Conversion of published weights to ONNX, used by `wayloom models convert` alone."""
