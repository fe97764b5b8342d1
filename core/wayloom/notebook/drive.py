"""Processed drive: what `wayloom process` left in a folder, each part read when it is first asked for."""

import base64
import html
import json
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.exports.drive_origin import REPORT_FILE
from wayloom.exports.points import PointBatch, batch_of_submap, joined_batches
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.types import GeoReference
from wayloom.georeference.uncertainty import position_covariance
from wayloom.labelling.files import LABELS_FILE, load_labels
from wayloom.labelling.types import PointLabels
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.submaps.files import load_submaps
from wayloom.submaps.submap import PlacedSubmap

FloatArray = NDArray[np.float64]
REMEDY: Final = "give the folder that `wayloom process` wrote"


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A drive's poses, one for each of its N frames.

    t_ns        (N,) int64 stamps of the log
    T_enu_cam   (N, 4, 4) left camera (x right, y down, z forward) in `frame`; frame None: the drive's own level frame
    covariance  (N, 6, 6) of the left perturbation (v, omega), m² and rad²; without GNSS relative to the first frame
    tracked     (N,) whether the odometry had hold of the frame
    """

    drive_id: str
    frame: MapFrame | None
    t_ns: NDArray[np.int64]
    T_enu_cam: FloatArray
    covariance: FloatArray
    tracked: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.t_ns)

    @property
    def positions(self) -> FloatArray:
        """(N, 3) m of the left camera in the frame."""
        return np.asarray(self.T_enu_cam[:, :3, 3])

    @property
    def lonlatheight(self) -> FloatArray:
        """(N, 3) degrees, degrees, ellipsoidal metres. Raises InputError without GNSS."""
        if self.frame is None:
            raise InputError(f"drive {self.drive_id} has no place on Earth", remedy="process it with gnss=…")
        return wgs84.lonlatheight_from_enu(self.positions, self.frame)

    @property
    def sigma_enu(self) -> FloatArray:
        """(N, 3) m: standard deviation of the camera's position along east, north and up."""
        variance = position_covariance(self.T_enu_cam, self.covariance)[:, [0, 1, 2], [0, 1, 2]]
        return np.sqrt(np.maximum(variance, 0.0))


class Drive:
    """A folder that `wayloom process` wrote. Raises InputError for a folder that is none."""

    def __init__(self, folder: str | PathLike[str]) -> None:
        self.folder = Path(folder)
        if not (self._stages / "submaps" / "index.json").is_file():
            raise InputError("holds no processed drive", file=self.folder, remedy=REMEDY)

    @property
    def _stages(self) -> Path:
        return self.folder / "stages"

    @cached_property
    def facts(self) -> dict[str, Any]:
        """report.json: what was tracked, labelled and found, and what to be wary of (`facts["warnings"]`)."""
        return self._json(REPORT_FILE)

    @cached_property
    def quality(self) -> dict[str, Any]:
        """quality.json: grade, fixes, drift, sigmas along the way (docs/formats.md)."""
        return self._json("quality.json")

    @cached_property
    def odometry(self) -> OdometryResult:
        """The odometry alone: poses and points in the drive's own frame, before GNSS and loops."""
        return load_odometry(self._stages / "odometry" / ODOMETRY_FILE)

    @cached_property
    def georeference(self) -> GeoReference:
        """Frame, poses, covariances, residuals of the fixes."""
        return load_georeference(self._stages / "georeference" / GEOREFERENCE_FILE)

    @cached_property
    def labels(self) -> PointLabels:
        """Of the points of `odometry`: of the host image alone, and after temporally consistent labelling."""
        return load_labels(self._stages / "labelling" / LABELS_FILE)

    @cached_property
    def submaps(self) -> list[PlacedSubmap]:
        """The drive's immutable pieces in the order of the road, each with its pose and covariance."""
        return load_submaps(self._stages / "submaps")

    @property
    def frame(self) -> MapFrame | None:
        """Tangent plane of `trajectory` and `cloud`; None: the drive's own level frame."""
        return self.georeference.frame

    @property
    def name(self) -> str:
        """The drive's id in maps."""
        return self.submaps[0].drive_id if self.submaps else self.folder.name

    @cached_property
    def trajectory(self) -> Trajectory:
        """Poses with covariances after GNSS and loops."""
        geo, odometry = self.georeference, self.odometry.trajectory
        return Trajectory(self.name, geo.frame, odometry.t_ns, geo.T_enu_cam, geo.covariance, odometry.tracked)

    @cached_property
    def cloud(self) -> PointBatch:
        """All labelled points of the drive, vehicles included: places (P, 3) m in `frame`, train ids, sigmas, votes."""
        return joined_batches([batch_of_submap(placed) for placed in self.submaps])

    def _json(self, name: str) -> dict[str, Any]:
        file = self.folder / name
        try:
            return dict(json.loads(file.read_text(encoding="utf-8")))
        except (OSError, ValueError) as error:
            raise InputError(f"cannot be read ({error})", file=file, remedy="process the drive again") from error

    def __repr__(self) -> str:
        where = "own frame" if self.frame is None else "geo-referenced"
        return (
            f"Drive({self.name}: {len(self.trajectory)} frames, {len(self.cloud)} points, {where}, grade {self.quality['grade']})"
        )

    def _repr_html_(self) -> str:
        """What a notebook shows: the drive from above and its numbers."""
        picture = self.folder / "map.png"
        shown = f'<img src="data:image/png;base64,{base64.b64encode(picture.read_bytes()).decode()}" style="max-width:640px">'
        return f"<p><code>{html.escape(repr(self))}</code></p>{shown if picture.is_file() else ''}"
