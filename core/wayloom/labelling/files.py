"""File format of point labels: one npz file whose bytes depend on the labels alone."""

import zipfile
import zlib
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import StageError
from wayloom.files.atomic import replacing
from wayloom.labelling.types import PointLabels

LABELS_FILE: Final = "labels.npz"
FORMAT_VERSION: Final = 1
NO_VOTES: Final[dict[str, NDArray[Any]]] = {
    "vote_start": np.zeros(1, np.int64), "vote_class": np.zeros(0, np.uint8), "vote_weight": np.zeros(0, np.float32),
}  # fmt: skip
_EPOCH: Final = (1980, 1, 1, 0, 0, 0)


def save_labels(labels: PointLabels, path: Path) -> None:
    """Write the labels; the file appears whole or not at all."""
    arrays: dict[str, NDArray[Any]] = {"format_version": np.array(FORMAT_VERSION, np.int64)}
    arrays |= {field.name: getattr(labels, field.name) for field in fields(PointLabels)}
    with replacing(path) as stream, zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as archive:
        for name, array in arrays.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy", _EPOCH), "w") as file:
                np.lib.format.write_array(file, np.asarray(array, order="C"), version=(1, 0), allow_pickle=False)


def load_labels(path: Path, votes: bool = True) -> PointLabels:
    """Read what `save_labels` wrote; the votes, which are most of it, only where they are wanted. Raises StageError where the file
    is missing, damaged or of another version."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            version = int(archive["format_version"])
            names = [field.name for field in fields(PointLabels) if votes or not field.name.startswith("vote_")]
            arrays = {name: archive[name] for name in names} if version == FORMAT_VERSION else {}
    except (OSError, EOFError, ValueError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise StageError(f"{path}: no readable file of labels ({type(error).__name__}); run the labelling again") from error
    if not arrays:
        raise StageError(f"{path}: format {version}, this version reads {FORMAT_VERSION}; run the labelling again")
    if votes:
        return PointLabels(**arrays)
    return PointLabels(**arrays, **NO_VOTES).without_votes()
