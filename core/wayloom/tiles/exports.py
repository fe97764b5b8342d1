"""Map exports: PLY, LAZ, GeoJSON, a picture, a folder of tiles."""

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import laspy
import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_ID, CLASS_NAMES, PALETTE_WITH_VOID
from wayloom.files.atomic import write_atomically
from wayloom.files.ply import write_ply
from wayloom.geodesy import wgs84
from wayloom.geodesy.antimeridian import line_geometry, median_place
from wayloom.geodesy.geoid import GeoidGrid
from wayloom.geodesy.map_frame import MapFrame
from wayloom.geometry import se3
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.tiles.formats import TILE_FORMATS
from wayloom.tiles.preview import top_down
from wayloom.tiles.pyramid import Track, build_tiles

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
LAZ_SCALE_M: Final = 0.001
ELLIPSOIDAL, ORTHOMETRIC = "ellipsoidal heights", "orthometric heights"


def export_ply(path: Path, points: FloatArray, labels: NDArray[np.uint8], frame: MapFrame | None = None) -> None:
    """points (N, 3) m in the map's frame (or a drive's own without frame), coloured by their labels (N,)."""
    comment = (
        "frame: the drive's own world"
        if frame is None
        else f"frame: ENU at {frame.lon_deg} {frame.lat_deg} {frame.height_m} (WGS84)"
    )
    write_ply(path, points, PALETTE_WITH_VOID[labels], labels, (comment,))


def export_laz(
    path: Path, points: FloatArray, labels: NDArray[np.uint8], frame: MapFrame | None = None, geoid: GeoidGrid | None = None
) -> None:
    """LAZ 1.4, point format 7: UTM of the place with the CRS in its header, or the drive's own frame.

    The zone is that of the median point, for all points: a cloud that reaches into the next zone stays in one piece, and the
    projection is exact there too. Heights are ellipsoidal, or, with a geoid grid, orthometric; `system_identifier` says which.
    Raises InputError where there is no UTM, or where the grid does not reach.
    points (N, 3) m and labels (N,) as in `export_ply`. `classification` is the ASPRS class, the extra dimension `label` ours.
    """
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("label", np.uint8, "train id, 255 void"))
    header.generating_software = "wayloom"
    coordinates = np.asarray(points, np.float64).reshape(-1, 3)
    if frame is not None and len(coordinates):
        lon_lat_height = wgs84.lonlatheight_from_enu(coordinates, frame)
        place = median_place(lon_lat_height)
        epsg = wgs84.utm_epsg(place.lon_deg, place.lat_deg)
        header.add_crs(wgs84.utm_crs(epsg))
        coordinates = wgs84.utm_from_lonlatheight(lon_lat_height, epsg)
        header.system_identifier = ELLIPSOIDAL
        if geoid is not None:
            coordinates[:, 2] = geoid.orthometric(lon_lat_height)
            header.system_identifier = ORTHOMETRIC
    header.scales = np.full(3, LAZ_SCALE_M)
    header.offsets = np.floor(coordinates.min(axis=0)) if len(coordinates) else np.zeros(3)
    header.global_encoding.wkt = True
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = coordinates.T
    cloud.classification = ASPRS[labels]
    cloud.red, cloud.green, cloud.blue = PALETTE_WITH_VOID[labels].astype(np.uint16).T * 257
    cloud.label = labels
    buffer = io.BytesIO()
    cloud.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    write_atomically(path, buffer.getvalue())


def export_geojson_track(path: Path, T_enu_cam: FloatArray, frame: MapFrame, name: str = "") -> None:
    """The camera's track (N, 4, 4) as a WGS84 line with ellipsoidal heights, longitude first (RFC 7946)."""
    lon_lat_height = wgs84.lonlatheight_from_enu(T_enu_cam[:, :3, 3], frame)
    line = [[round(lon, 9), round(lat, 9), round(height, 3)] for lon, lat, height in lon_lat_height.tolist()]
    feature = {"type": "Feature", "properties": {"name": name}, "geometry": line_geometry(line)}
    write_atomically(path, json.dumps({"type": "FeatureCollection", "features": [feature]}).encode())


def export_preview(
    path: Path,
    points: FloatArray,
    labels: NDArray[np.uint8],
    frame: MapFrame | None = None,
    tracks_enu: tuple[FloatArray, ...] = (),
) -> None:
    """`top_down` as a PNG; the arrow to the north only with a frame. It is drawn in the plane of the cloud's own place, since far
    from the frame's origin the frame leans."""
    if frame is not None and len(points):
        place = median_place(wgs84.lonlatheight_from_enu(points, frame))
        T_place_enu = wgs84.T_enu_enu(place, frame)
        points = se3.transform(T_place_enu, points)
        tracks_enu = tuple(se3.transform(T_place_enu, track) for track in tracks_enu)
    picture = top_down(points, labels, tracks_enu=tracks_enu, north_up=frame is not None)
    _, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
    write_atomically(path, data.tobytes())


def export_tiles(folder: Path, voxel_map: VoxelMap, tracks: Sequence[Track] = ()) -> int:
    """All tiles as files <folder>/<layer>/<z>/<x>/<y><suffix>, as any static server can hand them out. How many there are."""
    suffix = {form.layer: form.suffix for form in TILE_FORMATS.values()}
    count = 0
    for tile in build_tiles(voxel_map, voxel_map.frame, tracks=tracks):
        write_atomically(folder / tile.layer / str(tile.z) / str(tile.x) / f"{tile.y}{suffix[tile.layer]}", tile.data)
        count += 1
    return count
