"""Submap folder: `index.json` with the pose of each submap, `<digest>.submap` with its content."""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final, overload

import numpy as np

from wayloom.errors import InputError
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.map_frame import MapFrame
from wayloom.submaps.submap import PlacedSubmap, StepBefore, decode_submap

FORMAT = "wayloom-submaps"
VERSION = 1
INDEX = "index.json"
BEND_DIGITS = 5
"""Decimals: 10 um and 10 urad."""
REMEDY = "make the submaps again"
SUBMAPS_HELD: Final = 16
"""A kilometre of road: a drive that is no longer is read once."""


def save_submaps(placed: Iterable[PlacedSubmap], folder: Path) -> None:
    """Write the submaps, then the index: a folder with an index is whole."""
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for item in placed:
        data = item.submap.encoded
        digest = hashlib.sha256(data).hexdigest()
        write_atomically(folder / f"{digest}.submap", data)
        entries.append(_entry(item, digest))
    text = json.dumps({"format": FORMAT, "version": VERSION, "submaps": entries}, indent=1, sort_keys=True)
    write_atomically(folder / INDEX, text.encode())


@dataclass(frozen=True, slots=True)
class SubmapEntry:
    """A submap's line in the index of a folder: what is known of it before its points are read."""

    folder: Path
    content: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """The submap's name."""
        return str(self.content["digest"])

    @property
    def drive_id(self) -> str:
        """The drive that the map names."""
        return str(self.content["drive_id"])

    @property
    def frame(self) -> MapFrame | None:
        """The frame of its place; None: the drive's own."""
        return None if self.content["frame"] is None else MapFrame(*self.content["frame"])

    def load(self) -> PlacedSubmap:
        """The submap. Raises InputError that names the file that is missing or damaged."""
        return _load(self.folder, self.content)


class StoredSubmaps(Sequence[PlacedSubmap]):
    """The submaps of a folder, in the order they were saved: each is read when it is asked for, and the last ones stay in memory.

    Any thread may ask. The index is read at once. Raises InputError, whenever that is, that names a missing or damaged file.
    """

    def __init__(self, folder: Path) -> None:
        entries = submap_entries(folder)
        self._count = len(entries)
        self._held = lru_cache(SUBMAPS_HELD)(lambda row: entries[row].load())

    def __len__(self) -> int:
        return self._count

    @overload
    def __getitem__(self, row: int) -> PlacedSubmap: ...
    @overload
    def __getitem__(self, row: slice) -> list[PlacedSubmap]: ...
    def __getitem__(self, row: int | slice) -> PlacedSubmap | list[PlacedSubmap]:
        rows = range(len(self))[row]
        return self._held(rows) if isinstance(rows, int) else [self._held(one) for one in rows]


def load_submaps(folder: Path) -> list[PlacedSubmap]:
    """The submaps in the order they were saved. Raises InputError that names the file that is missing or damaged."""
    return [entry.load() for entry in submap_entries(folder)]


def submap_entries(folder: Path) -> list[SubmapEntry]:
    """The submaps of a folder, none of them read yet, in the order they were saved. Raises InputError."""
    path = folder / INDEX
    try:
        index = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(
            f"is no index of submaps ({error})", file=path, remedy="give the folder that the submaps stage wrote"
        ) from error
    if not isinstance(index, dict) or index.get("format") != FORMAT or index.get("version") != VERSION:
        raise InputError(f"is no {FORMAT} of version {VERSION}", file=path, remedy=REMEDY)
    return [SubmapEntry(folder, entry) for entry in index["submaps"]]


def _entry(item: PlacedSubmap, digest: str) -> dict[str, Any]:
    frame = item.frame
    return {
        "digest": digest,
        "drive_id": item.drive_id,
        "frame": None if frame is None else [frame.lon_deg, frame.lat_deg, frame.height_m],
        "T_enu_submap": item.T_enu_submap.tolist(),
        "covariance": item.covariance.tolist() if np.isfinite(item.covariance).all() else None,
        "points": len(item.submap),
        "length_m": item.submap.length_m,
        "before": None if item.before is None else item.before.content(),
        "bend": None if item.bend is None else np.round(item.bend, BEND_DIGITS).tolist(),
    }


def _load(folder: Path, entry: Mapping[str, Any]) -> PlacedSubmap:
    path = folder / f"{entry['digest']}.submap"
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", file=path, remedy=REMEDY) from error
    if hashlib.sha256(data).hexdigest() != entry["digest"]:
        raise InputError("does not hold what its name says", file=path, remedy=REMEDY)
    covariance = np.full((6, 6), np.nan) if entry["covariance"] is None else np.array(entry["covariance"], np.float64)
    frame = None if entry["frame"] is None else MapFrame(*entry["frame"])
    told = entry.get("before")  # not in files of before it was told
    before = None if told is None else StepBefore.of(told)
    T_enu_submap = np.array(entry["T_enu_submap"], np.float64)
    bend = None if entry.get("bend") is None else np.array(entry["bend"], np.float64).reshape(-1, 6)  # likewise
    submap = decode_submap(data, str(path), entry["digest"])
    if bend is not None and len(bend) != len(submap.keyframe_frame):
        raise InputError("tells bends of another number of keyframes", file=folder / INDEX, remedy=REMEDY)
    return PlacedSubmap(submap, T_enu_submap, covariance, entry["drive_id"], frame, before, bend)
