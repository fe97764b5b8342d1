"""Published weights to ONNX: what `wayloom models convert` does, and nothing else in wayloom."""
