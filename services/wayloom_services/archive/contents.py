"""Members of a drive's archive: what the service has of it, each with the words that the archive's README says of it."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import structlog
from numpy.typing import NDArray

from wayloom.errors import InputError, NotFoundError
from wayloom.exports.ply import ply_blocks
from wayloom.files.trajectory_files import tum_text
from wayloom.geodesy.antimeridian import line_geometry
from wayloom.geodesy.map_frame import MapFrame
from wayloom.ground.files import SHEETS
from wayloom.ground.sheet import CELL_M, PIXEL_M, GroundSheet
from wayloom.objects.exports import feature
from wayloom.objects.files import SIGHTINGS
from wayloom.objects.fusion import fuse
from wayloom.objects.settings import ObjectFusionSettings
from wayloom.objects.types import PlacedSightings
from wayloom.reports.served_drive import render
from wayloom.store.blobs import BlobStore
from wayloom.store.tables.drives import SubmapRow
from wayloom.submaps.submap import PlacedSubmap
from wayloom_services.archive.readme import readme
from wayloom_services.archive.zip_stream import Member
from wayloom_services.drive_results import placed_submap, without_persons

log = structlog.get_logger()
STAGES: Final = ("ground", "objects")
"""Whose outputs are read where they lie on this disk."""


@dataclass(frozen=True)
class DriveContents:
    """What the database says of a drive, and where the rest is.

    drive   as `GET /v1/drives/{id}` tells it; track: (K, 2 or 3) longitude, latitude and height, None where it has no place
    history as `GET /v1/drives/{id}/history` does, all of it
    quality, preview : digests of its report and its picture, where it has them
    rows    its submaps, in the order of the road
    folders of the outputs of STAGES
    """

    blobs: BlobStore
    drive: dict[str, Any]
    track: list[Any] | None
    history: list[dict[str, Any]]
    quality: str | None
    preview: str | None
    rows: list[SubmapRow]
    folders: Mapping[str, Path]

    @property
    def frame(self) -> MapFrame | None:
        """The map's frame; None where the drive has no place on Earth."""
        return MapFrame(*self.rows[0].frame) if self.rows and self.rows[0].frame is not None else None

    def check(self) -> None:
        """Raises NotFoundError where a blob of the drive is gone: an archive that has begun can say so only by breaking off."""
        for digest in filter(None, (self.quality, self.preview, *(row.digest for row in self.rows))):
            if not self.blobs.has(digest):
                raise NotFoundError(f"blob {digest} of this drive is not in the store")

    def members(self) -> Iterator[Member]:
        """The files one after another, the README last: it lists those that are there."""
        told: dict[str, str] = {}
        for member in self._results():
            if member.about:
                told[member.name] = member.about
            yield member
        yield Member("README.txt", (readme(self.drive, told, self.frame),), "this text")

    def _results(self) -> Iterator[Member]:
        yield _as_json("drive.json", self.drive, "the drive: name, vehicle, stages, grade with reasons, facts of each stage")
        yield _as_json("history.json", self.history, "the log of attempts: what became of each at each stage, newest first")
        if self.track:
            line = {"type": "Feature", "geometry": line_geometry(self.track), "properties": {"name": self.drive["name"]}}
            yield _as_json("track.geojson", line, "the track: longitude, latitude in degrees, height in m where it is told, WGS84")
        if self.preview is not None:
            yield Member("preview.png", self._blob(self.preview), "the labelled points from above", packed=False)
        if self.quality is not None:
            yield from self._report(json.loads(self.blobs.get(self.quality)))
        if self.rows:
            yield from self._of_submaps()

    def _report(self, found: dict[str, Any]) -> Iterator[Member]:
        pictures = found["pictures"]
        numbers = found | {"pictures": sorted(pictures)}
        yield _as_json("quality.json", numbers, "the quality report's numbers (docs/formats.md, “Quality of a drive”)")
        for name, picture in sorted(pictures.items()):
            yield Member(f"quality/{name}.svg", (picture.encode(),), "a plot of the quality report")
        yield Member("report.html", (render(self.drive, found, pictures).encode(),), "the quality report as a page by itself")

    def _of_submaps(self) -> Iterator[Member]:
        t_ns, T, count = self._passed_through
        yield Member(
            "trajectory.tum", (tum_text(t_ns, T),),
            "poses of the keyframes' left camera: seconds since 1970 (UTC), x y z in m, quaternion x y z w; "
            f"{'the map frame, see below' if self.frame else 'in the frame of the drive itself'}",
        )  # fmt: skip
        yield Member(
            "cloud.ply", self._cloud(count),
            "labelled points, persons left out: x y z in m near an origin that the comment in its header names (east, north, up; "
            "WGS84), colour and train id of the class, sigma in m, time in seconds since 1970 (UTC)",
            packed=False, huge=True,
        )  # fmt: skip
        yield from self._objects()
        yield from self._ground()

    @cached_property
    def _passed_through(self) -> tuple[NDArray[np.int64], NDArray[np.float64], int]:
        """Times (K,) ns and poses (K, 4, 4) of the keyframes, and how many points there are without persons, by one pass."""
        t_ns, T, count = [], [], 0
        for one in self._placed():
            t_ns.append(one.submap.keyframe_t_ns)
            T.append(one.T_enu_submap @ one.submap.T_submap_cam)
            count += len(without_persons(one))
        times, first = np.unique(np.concatenate(t_ns), return_index=True)  # neighbours share the keyframe at which they meet
        return times, np.concatenate(T)[first], count

    def _placed(self) -> Iterator[PlacedSubmap]:
        return (placed_submap(self.blobs, row) for row in self.rows)

    def _cloud(self, count: int) -> Iterator[bytes]:
        place = np.array(self.rows[0].T_enu_submap, np.float64)[:3, 3]
        yield from ply_blocks(map(without_persons, self._placed()), count, place, self.frame)

    def _blob(self, digest: str) -> Iterator[bytes]:
        yield self.blobs.get(digest)

    def _objects(self) -> Iterator[Member]:
        """Of a drive with a place on Earth, as `objects.geojson` of `wayloom process` has them."""
        if self.frame is None:
            return
        seen = [
            PlacedSightings(found, _matrix(row.T_enu_submap), _matrix(row.covariance), row.drive_id)
            for row in self.rows
            if (found := self._kept("objects", row.digest)) is not None
        ]
        if seen:
            features = [feature(one, self.frame) for one in fuse(seen, ObjectFusionSettings())]
            about = (
                "poles, traffic signs and lights, and trunks, of this drive alone: longitude and latitude in degrees, height in m"
            )
            yield _as_json("objects.geojson", {"type": "FeatureCollection", "features": features}, about)

    def _ground(self) -> Iterator[Member]:
        """A picture of each submap's ground, one in memory at a time, and the list of where they lie."""
        listed = []
        for number, row in enumerate(self.rows):
            sheet = self._kept("ground", row.digest)
            if sheet is not None:
                name = f"ground/{number:04d}.png"
                listed.append({"file": name, **_place_of(sheet, _matrix(row.T_enu_submap))})
                yield Member(name, (_picture(sheet),), packed=False)
        if listed:
            about = (
                "where the ground's pictures ground/*.png lie: their lower left corner corner_m in the sheet's frame, x to the "
                "right, y up the picture, pixel_m metres a pixel, and T_map_sheet (4 x 4), which takes the sheet's frame to that "
                "of trajectory.tum"
            )
            yield _as_json("ground/index.json", {"pixel_m": PIXEL_M, "sheets": listed}, about)

    def _kept(self, stage: str, submap: str) -> Any:
        """What a stage left of a submap; None where it left nothing that can be read."""
        kind: Any = {"ground": SHEETS, "objects": SIGHTINGS}[stage]
        try:
            digest = self._listed(stage, kind).get(submap)
            return None if digest is None else kind.load(self.folders[stage], digest)
        except InputError as error:
            log.warning("not in a drive's archive", drive_id=self.drive["id"], stage=stage, error=str(error))
            return None

    @cached_property
    def _indices(self) -> dict[str, dict[str, str]]:
        return {}

    def _listed(self, stage: str, kind: Any) -> dict[str, str]:
        if stage not in self._indices:
            has = stage in self.folders and self.folders[stage].is_dir()
            self._indices[stage] = {}  # read once, whether or not that goes well
            self._indices[stage] = kind.read_index(self.folders[stage]) if has else {}
        return self._indices[stage]


def _as_json(name: str, content: Any, about: str) -> Member:
    return Member(name, (json.dumps(content, indent=1, ensure_ascii=False).encode() + b"\n",), about)


def _matrix(rows: list[Any]) -> NDArray[np.float64]:
    return np.array(rows, np.float64)


def _place_of(sheet: GroundSheet, T_map_submap: NDArray[np.float64]) -> dict[str, Any]:
    first_s, last_s = (sheet.t_ns * 1e-9).tolist()
    T_map_sheet = (T_map_submap @ sheet.T_submap_sheet).tolist()
    return {"corner_m": (sheet.corner * CELL_M).tolist(), "T_map_sheet": T_map_sheet, "first_s": first_s, "last_s": last_s}


def _picture(sheet: GroundSheet) -> bytes:
    """PNG, clear where nothing was seen, rows from the top: a sheet's go up."""
    colour = sheet.colour if sheet.colour.shape[2] == 3 else sheet.colour.repeat(3, axis=2)
    seen = np.where(sheet.sharpness > 0, 255, 0).astype(np.uint8)
    picture = np.dstack([colour[..., ::-1], seen])[::-1]
    return bytes(cv2.imencode(".png", np.ascontiguousarray(picture))[1])
