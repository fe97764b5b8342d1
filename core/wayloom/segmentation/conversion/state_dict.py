"""Reader of PyTorch state dicts without PyTorch, with a restricted unpickler.

A `.pt` file is a zip archive: `NAME/data.pkl`, a pickle that says how tensors lie in storages, and `NAME/data/KEY`, the bytes of
each storage. Here the pickle may call two things only, the rebuilding of a tensor and an ordered dictionary; whatever else it names
ends the reading. That is what `torch.load(..., weights_only=True)` promises, in the small.
"""

import io
import math
import pickle
import zipfile
import zlib
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import ModelError

Tensors = dict[str, NDArray[Any]]

MAX_PICKLE_BYTES: Final = 64 * 2**20
MAX_STORAGE_BYTES: Final = 4 * 2**30
_DTYPES: Final = {
    "DoubleStorage": "<f8", "FloatStorage": "<f4", "HalfStorage": "<f2",
    "LongStorage": "<i8", "IntStorage": "<i4", "ShortStorage": "<i2", "CharStorage": "|i1", "ByteStorage": "|u1",
}  # fmt: skip
_DAMAGED: Final = (ValueError, KeyError, IndexError, TypeError, AttributeError, RuntimeError, OverflowError, zlib.error)
"""What an unpickler and a zip archive raise on damaged bytes (errors of text and overflow are among the first)."""
_REMEDY: Final = "give the file of weights (a state dict) as it was published"


class _RefusedError(Exception):
    """The pickle names something that is no part of a state dict."""


@dataclass(frozen=True, slots=True)
class _StorageType:
    dtype: np.dtype[Any]


def read_state_dict(path: Path) -> Tensors:
    """Name to array of the state dict in a `.pt` or `.pth` file; a dict that holds one under `state_dict` is opened.

    Raises ModelError where the file is missing or no zip archive of PyTorch's, asks for anything but tensors, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            found = _Unpickler(archive).load()
    except FileNotFoundError as error:
        raise ModelError("no such file", file=path, remedy=_REMEDY) from error
    except _RefusedError as error:
        raise ModelError(f"holds more than weights ({error}); it was not run", file=path, remedy=_REMEDY) from error
    except (zipfile.BadZipFile, pickle.UnpicklingError, OSError, EOFError, MemoryError, *_DAMAGED) as error:
        what = " ".join((str(error) or type(error).__name__).split())[:120]
        raise ModelError(f"no readable PyTorch file of weights ({what})", file=path, remedy=_REMEDY) from error
    if isinstance(found, dict) and isinstance(found.get("state_dict"), dict):
        found = found["state_dict"]
    if not isinstance(found, dict) or not found or not all(isinstance(v, np.ndarray) for v in found.values()):
        raise ModelError("is no state dict: names and their tensors", file=path, remedy=_REMEDY)
    return {str(name): tensor for name, tensor in found.items()}


class _Unpickler(pickle.Unpickler):
    """Knows the names that a state dict needs, and storages by their key in the archive."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
        if len(names) != 1:
            raise zipfile.BadZipFile("no data.pkl in it")
        self._archive, self._root = archive, names[0].removesuffix("data.pkl")
        super().__init__(io.BytesIO(_entry(archive, names[0], MAX_PICKLE_BYTES)))

    def find_class(self, module: str, name: str, /) -> Any:
        if module == "torch" and name in _DTYPES:
            return _StorageType(np.dtype(_DTYPES[name]))
        known = {("collections", "OrderedDict"): OrderedDict, ("torch._utils", "_rebuild_tensor_v2"): _tensor}
        if (module, name) not in known:
            raise _RefusedError(f"it names {module}.{name}")
        return known[module, name]

    def persistent_load(self, pid: Any, /) -> NDArray[Any]:
        kind, storage_type, key, _, count = pid
        if kind != "storage" or not isinstance(storage_type, _StorageType):
            raise _RefusedError(f"it names a {kind!r}")
        size = int(count) * storage_type.dtype.itemsize
        data = _entry(self._archive, f"{self._root}data/{key}", MAX_STORAGE_BYTES)
        if len(data) < size:
            raise ValueError(f"storage {key} has {len(data)} bytes, not {size}")
        return np.frombuffer(data, storage_type.dtype, int(count))


def _entry(archive: zipfile.ZipFile, name: str, limit: int) -> bytes:
    size = archive.getinfo(name).file_size
    if size > limit:
        raise ValueError(f"{name} has {size} bytes")
    return archive.read(name)


def _tensor(storage: Any, offset: Any, size: Any, stride: Any, *_: Any) -> NDArray[Any]:
    """The tensor's part of its storage, copied; what follows (gradients, hooks) does not matter for weights."""
    if not isinstance(storage, np.ndarray) or len(size) != len(stride):
        raise ValueError("a tensor without a storage")
    shape, steps, first = tuple(map(int, size)), tuple(map(int, stride)), int(offset)
    if min((first, *shape, *steps)) < 0:
        raise ValueError("a tensor of negative size")
    last = first + sum((n - 1) * step for n, step in zip(shape, steps, strict=True))
    if math.prod(shape) and (last >= len(storage) or math.prod(shape) > len(storage)):
        raise ValueError("a tensor runs over its storage")
    if not math.prod(shape):
        return np.zeros(shape, storage.dtype)
    strides = tuple(step * storage.itemsize for step in steps)
    return np.lib.stride_tricks.as_strided(storage[first:], shape, strides, writeable=False).copy()
