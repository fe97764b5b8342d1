"""Image to class: the catalogue of networks and the only import of onnxruntime."""
