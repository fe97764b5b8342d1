"""Semantic 3D mapping of a city with a vehicle fleet, from stereo cameras and GNSS alone.

`open_log`, `process`, `Drive` and `Map` are the doors for notebooks and scripts (docs/python-api.md). They are imported when they
are first asked for, so that `import wayloom` costs nothing.
"""

import os as _os
from importlib import import_module as _import_module
from pathlib import Path as _Path

from wayloom.config.kernel_cache import use_kernel_cache as _use_kernel_cache

__version__ = "0.1.0"
_DOORS = ("Drive", "Map", "open_log", "process")

_os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
"""onnxruntime reads it when it is imported, by whomever; nothing is recorded or sent unasked."""
_use_kernel_cache(_Path(__file__).parent)


def __getattr__(name: str) -> object:
    if name not in _DOORS:
        raise AttributeError(f"module 'wayloom' has no attribute {name!r}; its doors are {', '.join(_DOORS)}")
    return getattr(_import_module("wayloom.notebook"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_DOORS})
