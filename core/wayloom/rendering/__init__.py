"""Rendered views of clouds and maps: scenes, cameras, z-buffer splatting with eye-dome lighting, pictures and films."""
