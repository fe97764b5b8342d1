"""Lineage endpoint: which drives, submaps, networks, code and settings a place of a map version was made from."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np
from fastapi import APIRouter, Depends, Query

from wayloom.config.classes import CLASS_NAMES
from wayloom.geodesy import wgs84
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.columns import column
from wayloom.stitching.region_files import decode_region
from wayloom.stitching.region_grid import RegionKey, regions_of_box
from wayloom.stitching.voxel_map import VoxelMap
from wayloom.store import lineage, maps
from wayloom.store.database import Session
from wayloom.store.tables.maps import MapVersion, RegionRow
from wayloom.tiles.grid import check_tile, tile_bounds
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import MapId, Number
from wayloom_services.schemas.lineage import DriveLineage, LineageOut, RegionOut, VoxelOut
from wayloom_services.views import run_out

COARSEST_ZOOM: Final = 14
"""Of a tile that is asked for: some hundreds of regions."""
MOST_VOXELS: Final = 200
M_PER_DEGREE: Final = 111_000.0

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@dataclass(frozen=True, slots=True)
class Place:
    """A tile, or a point."""

    tile: Annotated[str | None, Query(pattern=r"^\d{1,2}/\d{1,8}/\d{1,8}$", description="z/x/y, of zoom 14 and finer")] = None
    lon: Annotated[float | None, Query(ge=-180, le=180, description="degrees, with lat instead of a tile")] = None
    lat: Annotated[float | None, Query(ge=-85, le=85)] = None
    radius_m: Annotated[float, Query(gt=0, le=10, description="around the point")] = 0.5

    def box(self) -> maps.Box:
        """Degrees around the tile or the point. Raises ProtocolError where neither, or both, are asked for."""
        if self.tile is not None and self.lon is None and self.lat is None:
            address = check_tile(*(int(part) for part in self.tile.split("/")))
            if address.z < COARSEST_ZOOM:
                raise ProtocolError(
                    400, "bad-request", f"tile {self.tile} is too wide: ask for one of zoom {COARSEST_ZOOM} or finer"
                )
            return tile_bounds(address)
        if self.tile is not None or self.lon is None or self.lat is None:
            raise ProtocolError(400, "bad-request", "ask for tile=z/x/y, or for lon and lat")
        lat = self.radius_m / M_PER_DEGREE
        lon = lat / float(np.cos(np.radians(self.lat)))
        return self.lon - lon, self.lat - lat, self.lon + lon, self.lat + lat


@router.get("/maps/{map_id}/versions/{number}/lineage")
async def lineage_of_place(map_id: MapId, number: Number, place: Annotated[Place, Depends()], service: ServiceDep) -> LineageOut:
    """What a tile or a point of a version was made from.

    The drives are those whose submaps reach the regions of the place. Of a point the voxels around it are named too, each with the
    drives that vote for it, and when these saw it first and last.
    """
    box = place.box()

    def read(session: Session) -> LineageOut:
        version = maps.version(session, map_id, number)
        regions = lineage.regions_of_version(session, version, _keys(box, version))
        drives = [_drive(origin) for origin in lineage.origins(session, version, regions)]
        voxels = None if place.lon is None or place.lat is None else _voxels(service, regions, place)
        return LineageOut(
            map_id=map_id, version=number, created_at=version.created_at, built_with=version.built_with,
            regions=[_region(row) for row in regions], drives=drives, voxels=voxels,
        )  # fmt: skip

    return await service.read(read)


def _keys(box: maps.Box, version: MapVersion) -> list[RegionKey]:
    """The regions that a box touches."""
    return [*regions_of_box(box, MapFrame(*version.frame), around_m=0.0)]


def _region(row: RegionRow) -> RegionOut:
    return RegionOut(east=row.east, north=row.north, digest=row.digest, inputs=row.inputs, bytes=row.size)


def _drive(origin: lineage.DriveOrigin) -> DriveLineage:
    name, vehicle_id = (None, None) if origin.drive is None else (origin.drive.name, origin.drive.vehicle_id)
    run = None if origin.run is None else run_out(origin.run)
    return DriveLineage(id=origin.drive_id, name=name, vehicle_id=vehicle_id, submaps=[*origin.submaps], run=run)


def _voxels(service: Service, regions: Sequence[RegionRow], place: Place) -> list[VoxelOut]:
    """Those of all layers around the point, nearest first."""
    found: list[VoxelOut] = []
    for row in regions:
        region = decode_region(service.blobs.get(row.digest), row.digest)
        for layer, voxels in region.layers.items():
            found += _column(layer, voxels, place) if len(voxels) else []
    return sorted(found, key=lambda one: (one.distance_m, one.height_m, one.layer))[:MOST_VOXELS]


def _column(layer: str, voxels: VoxelMap, place: Place) -> list[VoxelOut]:
    assert place.lon is not None
    assert place.lat is not None
    assert voxels.frame is not None
    rows, distance_m = column(voxels, place.lon, place.lat, place.radius_m)
    near = voxels.take(rows[:MOST_VOXELS])
    lon_lat_height = wgs84.lonlatheight_from_enu(near.points_enu, voxels.frame)
    return [
        VoxelOut(
            layer=layer, label=CLASS_NAMES[near.label[row]], lon=lon, lat=lat, height_m=height, distance_m=float(distance_m[row]),
            drives=[near.drive_ids[drive] for drive in near.drive[near.drive_start[row] : near.drive_start[row + 1]].tolist()],
            first_seen=int(near.first_seen_ns[row]) / 1e9, last_seen=int(near.last_seen_ns[row]) / 1e9,
        )
        for row, (lon, lat, height) in enumerate(lon_lat_height.tolist())
    ]  # fmt: skip
