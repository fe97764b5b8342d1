"""Semantic segmentation of images: the catalogue of networks, inference, class scores; the only import of onnxruntime."""
