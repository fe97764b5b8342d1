"""LAS 1.4 records of map points: header, coordinate system, dimensions, provenance. The only import of laspy."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import laspy
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, CLASS_NAMES, PALETTE_WITH_VOID
from wayloom.exports.points import PointBatch
from wayloom.files.gps_time import adjusted_gps_s
from wayloom.geodesy import wgs84
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.geodesy.map_frame import MapFrame

FloatArray = NDArray[np.float64]
USER_DEFINED: Final = 64
ASPRS_OF_CLASS: Final = {"road": 11, "sidewalk": 2, "terrain": 2, "building": 6, "vegetation": 5} | {
    name: USER_DEFINED + CLASS_ID[name]
    for name in CLASS_NAMES
    if name not in ("road", "sidewalk", "terrain", "building", "vegetation")
}
"""The LAS 1.4 class of each of ours (docs/formats.md): the standard's own, or 64, its first free number, + train id."""
UNCLASSIFIED: Final = 1
ASPRS: Final = np.full(256, UNCLASSIFIED, np.uint8)
ASPRS[[CLASS_ID[name] for name in ASPRS_OF_CLASS]] = list(ASPRS_OF_CLASS.values())
SCALE_M: Final = 0.001
POINT_FORMAT: Final = 7
FULL_RANGE: Final = 257
"""Of 8 bit to 16: LAS wants intensities and colours to fill their range."""
ELLIPSOIDAL, ORTHOMETRIC = "ellipsoidal heights", "orthometric heights"
USER_ID, PROVENANCE_RECORD = "wayloom", 1
MOST_VLR_BYTES: Final = 65_535
LIMITS_TOLD: Final = 0b110
"""Options of an extra dimension whose least and greatest value the header tells: laspy 2.7 takes a batch's first point's."""
DIMENSIONS: Final = (
    laspy.ExtraBytesParams("label", np.uint8, "train id, 255 void"),
    laspy.ExtraBytesParams("confidence", np.uint8, "votes for the label, 255 all"),
    laspy.ExtraBytesParams("sigma", np.uint16, "of the place, m", offsets=np.zeros(1), scales=np.array([SCALE_M])),
    laspy.ExtraBytesParams("drives", np.uint16, "drives that vote for it"),
)


@dataclass(frozen=True, slots=True)
class Projection:
    """Coordinates of a LAS file: UTM of a zone, or the drive's own frame where epsg is None.

    origin  (3,) whole metres that the coordinates are stored relative to
    geoid   heights are above it; None: ellipsoidal
    """

    frame: MapFrame | None
    epsg: int | None
    origin: FloatArray
    geoid: GeoidGrid | None = None

    def coordinates(self, points: FloatArray) -> FloatArray:
        """(N, 3) m of points (N, 3) m in the frame. Raises InputError where the geoid does not reach."""
        if self.frame is None or self.epsg is None:
            return points
        lon_lat_height = wgs84.lonlatheight_from_enu(points, self.frame)
        found = wgs84.utm_from_lonlatheight(lon_lat_height, self.epsg)
        if self.geoid is not None:
            found[:, 2] = self.geoid.orthometric(lon_lat_height)
        return found


def projection_at(place: FloatArray, frame: MapFrame | None, geoid: GeoidGrid | None = None) -> Projection:
    """UTM of the zone of a place (3,) m in the frame, for all points: a cloud that reaches into the next zone stays in one piece,
    and the projection is exact there too. Raises InputError where there is no UTM."""
    if frame is None:
        return Projection(None, None, np.floor(place))
    lon, lat, _ = wgs84.lonlatheight_from_enu(place[None], frame)[0].tolist()
    found = Projection(frame, wgs84.utm_epsg(lon, lat), np.zeros(3), geoid)
    return Projection(frame, found.epsg, np.floor(found.coordinates(place[None])[0]), geoid)


def las_header(projection: Projection, provenance: Mapping[str, Any]) -> laspy.LasHeader:
    """LAS 1.4, point format 7 with the extra dimensions, GPS time flagged as adjusted standard time, provenance as a record."""
    header = laspy.LasHeader(point_format=POINT_FORMAT, version="1.4")
    header.add_extra_dims([*DIMENSIONS])
    for one in header.vlrs.get("ExtraBytesVlr")[0].extra_bytes_structs:
        one.options &= ~LIMITS_TOLD
    header.generating_software = "wayloom"
    header.scales, header.offsets = np.full(3, SCALE_M), projection.origin
    header.global_encoding.wkt = True
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    if projection.epsg is not None:
        header.add_crs(wgs84.utm_crs(projection.epsg))
        header.system_identifier = ELLIPSOIDAL if projection.geoid is None else ORTHOMETRIC
    header.vlrs.append(provenance_record(provenance))
    return header


def provenance_record(provenance: Mapping[str, Any]) -> laspy.VLR:
    """The JSON of it; of thousands of drives, which do not fit, how many they are (the file beside it names them)."""
    data = json.dumps(provenance).encode()
    if len(data) > MOST_VLR_BYTES:
        drives = f"{len(provenance.get('drives', []))}, in the JSON file beside this one"
        data = json.dumps({**provenance, "drives": drives}).encode()
    return laspy.VLR(USER_ID, PROVENANCE_RECORD, "provenance, JSON", data[:MOST_VLR_BYTES])


def las_records(batch: PointBatch, projection: Projection, header: laspy.LasHeader) -> laspy.ScaleAwarePointRecord:
    """The records of a batch."""
    records = laspy.ScaleAwarePointRecord.zeros(len(batch), header=header)
    records.x, records.y, records.z = projection.coordinates(batch.points).T
    records.intensity = batch.grey.astype(np.uint16) * FULL_RANGE
    records.red, records.green, records.blue = PALETTE_WITH_VOID[batch.label].astype(np.uint16).T * FULL_RANGE
    records.classification = ASPRS[batch.label]
    records.gps_time = adjusted_gps_s(batch.seen_ns)
    records.return_number = records.number_of_returns = np.ones(len(batch), np.uint8)
    records["label"], records["confidence"], records["drives"] = batch.label, batch.confidence, batch.drives
    steps = np.nan_to_num(batch.sigma_m.astype(np.float64) / SCALE_M, nan=np.inf)
    records.array["sigma"] = np.rint(np.minimum(steps, np.iinfo(np.uint16).max)).astype(np.uint16)
    return records
