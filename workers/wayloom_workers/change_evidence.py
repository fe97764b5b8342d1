"""Evidence of change: the looks of drives as their stages left them, and what it says as features of a map."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any, Final

import numpy as np
import structlog

from wayloom.config.classes import CLASS_NAMES
from wayloom.dense.files import LOOKS_FILE, LookFile
from wayloom.dense.types import Looks
from wayloom.errors import InputError
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.change_types import KINDS, Change
from wayloom.stitching.placed_looks import PlacedLooks, place_looks
from wayloom.store import jobs
from wayloom.submaps.submap import PlacedSubmap
from wayloom_workers.stage_hooks import WorkerContext

log = structlog.get_logger()
HELD_FILES: Final = 64
HELD_LOOKS: Final = 64
GONE: Final = KINDS[0]


class DriveLooks:
    """The looks of drives, those that neighbouring regions share unpacked once."""

    def __init__(self, context: WorkerContext) -> None:
        self._context = context
        self._opened = lru_cache(HELD_FILES)(self._open)
        self._unpacked = lru_cache(HELD_LOOKS)(self._unpack)
        self._keys: dict[str, str | None] = {}

    def key(self, drive_id: str) -> str | None:
        """Key of the drive's stage of looks; None where it has left none that can be read, as before there were looks."""
        if drive_id not in self._keys:
            self._keys[drive_id] = self._key(drive_id)
        return self._keys[drive_id]

    def placed(self, submaps: Iterable[PlacedSubmap]) -> list[PlacedLooks]:
        """The looks of these submaps, where they lie."""
        with_looks = [item for item in submaps if len(item.submap.keyframe_frame) and self.key(item.drive_id) is not None]
        spans = [(item.drive_id, *item.submap.keyframe_frame[[0, -1]].tolist()) for item in with_looks]
        return [place_looks(item, self._unpacked(*span)) for item, span in zip(with_looks, spans, strict=True)]

    def _key(self, drive_id: str) -> str | None:
        with self._context.database.read() as session:
            key = jobs.keys_of_outputs(session, drive_id, ("looks",)).get("looks")
        if key is None:
            return None
        try:
            self._opened(drive_id, key)
        except InputError as error:
            log.warning("drive bears no witness of change", drive_id=drive_id, error=str(error))
            return None
        return key

    def _open(self, drive_id: str, key: str) -> LookFile:
        return LookFile(self._context.folders.drive(drive_id) / "stages" / "looks" / key / LOOKS_FILE)

    def _unpack(self, drive_id: str, first: int, last: int) -> Looks:
        file = self._opened(drive_id, str(self.key(drive_id)))
        return file.read(np.flatnonzero((file.frame >= first) & (file.frame <= last)).tolist())


def change_features(changes: Sequence[Change], frame: MapFrame) -> list[dict[str, Any]]:
    """GeoJSON features of changes, points in degrees and ellipsoidal metres."""
    places = wgs84.lonlatheight_from_enu(np.array([one.position_enu for one in changes]).reshape(-1, 3), frame)
    return [
        {"type": "Feature", "geometry": {"type": "Point", "coordinates": _rounded(place)}, "properties": _properties(one)}
        for one, place in zip(changes, places.tolist(), strict=True)
    ]


def _rounded(place: Sequence[float]) -> list[float]:
    """A centimetre and better."""
    lon, lat, height = place
    return [round(lon, 8), round(lat, 8), round(height, 3)]


def _properties(change: Change) -> dict[str, Any]:
    return {
        "kind": change.kind,
        "class": CLASS_NAMES[change.label],
        "extent_m": list(change.extent_m),
        "points": change.points,
        "noticed": _utc(change.first_through_ns if change.kind == GONE else change.first_seen_ns),
        "seen_by": list(change.seen_by),
        "seen": change.seen,
        "first_seen": _utc(change.first_seen_ns),
        "last_seen": _utc(change.last_seen_ns),
        "seen_through_by": list(change.through_by),
        "seen_through": change.through,
        "first_seen_through": _utc(change.first_through_ns),
        "last_seen_through": _utc(change.last_through_ns),
    }


def _utc(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns // 1_000_000 / 1_000, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
