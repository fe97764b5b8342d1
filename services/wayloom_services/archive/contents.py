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

from wayloom.errors import InputError
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
from wayloom_services.archive.readme import readme
from wayloom_services.archive.zip_stream import Member
from wayloom_services.drive_points import DrivePoints, check_blobs

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

    @cached_property
    def points(self) -> DrivePoints | None:
        """None before the submaps are cut."""
        return DrivePoints(self.blobs, self.rows) if self.rows else None

    @property
    def frame(self) -> MapFrame | None:
        """The map's frame; None where the drive has no place on Earth."""
        return None if self.points is None else self.points.frame

    def check(self) -> None:
        """Raises NotFoundError where a blob of the drive is gone."""
        check_blobs(self.blobs, filter(None, (self.quality, self.preview, *(row.digest for row in self.rows))))

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
        if self.points is not None:
            yield from self._of_submaps(self.points)

    def _report(self, found: dict[str, Any]) -> Iterator[Member]:
        pictures = found["pictures"]
        numbers = found | {"pictures": sorted(pictures)}
        yield _as_json("quality.json", numbers, "the quality report's numbers (docs/formats.md, “Quality of a drive”)")
        for name, picture in sorted(pictures.items()):
            yield Member(f"quality/{name}.svg", (picture.encode(),), "a plot of the quality report")
        yield Member("report.html", (render(self.drive, found, pictures).encode(),), "the quality report as a page by itself")

    def _of_submaps(self, points: DrivePoints) -> Iterator[Member]:
        yield Member(
            "trajectory.tum", (points.trajectory(),),
            "poses of the keyframes' left camera: seconds since 1970 (UTC), x y z in m, quaternion x y z w; "
            f"{'the map frame, see below' if self.frame else 'in the frame of the drive itself'}",
        )  # fmt: skip
        yield Member(
            "cloud.ply", points.cloud()[1],
            "labelled points, persons left out: x y z in m near an origin that the comment in its header names (east, north, up; "
            "WGS84), colour and train id of the class, sigma in m, time in seconds since 1970 (UTC)",
            packed=False, huge=True,
        )  # fmt: skip
        yield from self._objects()
        yield from self._ground()

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
