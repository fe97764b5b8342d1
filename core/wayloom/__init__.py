"""Semantic 3D mapping of a city with a vehicle fleet, from stereo cameras and GNSS alone."""

from pathlib import Path as _Path

from wayloom.config.kernel_cache import use_kernel_cache as _use_kernel_cache

__version__ = "0.1.0"

_use_kernel_cache(_Path(__file__).parent)
