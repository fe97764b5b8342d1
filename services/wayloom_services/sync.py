"""Endpoints of a map's differences between versions, and of the synchronisation of a client that holds one."""

from collections.abc import Sequence
from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Path, Query

from wayloom.errors import NotFoundError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.stitching.region_grid import RegionKey, region_box
from wayloom.store import maps, version_diff
from wayloom.store.database import Session
from wayloom.store.map_versions import TileKey
from wayloom.store.tables.maps import RegionRow, TileRow
from wayloom.store.version_diff import FILES_OF_REGION, NOTHING, TileChange, TileChoice
from wayloom.tiles.descriptions import SUFFIXES
from wayloom.tiles.formats import SERVED_LAYERS
from wayloom_services.context import ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import ProtocolError
from wayloom_services.maps import BBox, MapId, Number, box_of_query
from wayloom_services.schemas.sync import (
    After,
    DiffOut,
    RegionDiff,
    RegionDiffOut,
    RegionThere,
    SyncIn,
    SyncOut,
    TileAnew,
    TileGone,
    TileThere,
    TileToDrop,
    TileToFetch,
)  # fmt: skip

Base = Annotated[int, Path(ge=0, le=2**31 - 1, description="the version before; 0: nothing")]
Limit = Annotated[int, Query(ge=1, le=20_000, description="how many addresses a page looks at at most")]
Layers = Annotated[str | None, Query(description="names of layers between commas; all by default", max_length=1000)]
TileAfter = Annotated[After | None, Query(description="`next` of the page before: layer, zoom, column, row")]
RegionAfter = Annotated[str | None, Query(pattern=r"^-?\d{1,9},-?\d{1,9}$", description="`next` of the page before: column, row")]
AROUND_M: Final = 0.0

router = APIRouter(prefix="/v1", tags=["maps"], dependencies=[Depends(require_key)], responses=PROBLEMS)


@router.get("/maps/{map_id}/diff/{base}/{number}")
async def diff(
    map_id: MapId, base: Base, number: Number, service: ServiceDep, layers: Layers = None, bbox: BBox = None, limit: Limit = 5000,
    after: TileAfter = None,
) -> DiffOut:  # fmt: skip
    """The tiles in which a version differs from another: added, changed and removed ones with digests and sizes, page by page.

    Either version may be the older one. A page may be empty before the last.
    """
    choice = _choice(None if layers is None else layers.split(","), bbox)

    def read(session: Session) -> DiffOut:
        _check(session, map_id, base, number)
        found, end = version_diff.tile_changes(session, map_id, (base, number), choice, limit, _key(after))
        came, changed, gone = _sorted_out(found)
        return DiffOut(
            map_id=map_id, base=base, version=number, next=_text(end),
            added=[TileThere(**_there(row)) for row in came],
            changed=[TileAnew(**_there(row), before=before) for row, before in changed],
            removed=[TileGone(**_at(key), before=before) for key, before in gone],
        )  # fmt: skip

    return await service.read(read)


@router.get("/maps/{map_id}/diff/{base}/{number}/regions")
async def diff_of_regions(
    map_id: MapId, base: Base, number: Number, service: ServiceDep, limit: Limit = 1000, after: RegionAfter = None
) -> RegionDiffOut:
    """The regions in which a version differs from another, with the digests of their voxels and features, page by page."""
    place = None if after is None else (int(after.split(",")[0]), int(after.split(",")[1]))

    def read(session: Session) -> RegionDiffOut:
        _check(session, map_id, base, number)
        frame = MapFrame(*maps.version(session, map_id, number).frame)
        found, end = version_diff.region_changes(session, map_id, (base, number), limit, place)
        return RegionDiffOut(
            map_id=map_id, base=base, version=number, next=None if end is None else f"{end[0]},{end[1]}",
            regions=[_region(key, before, now, frame) for key, before, now in found],
        )  # fmt: skip

    return await service.read(read)


@router.post("/maps/{map_id}/sync")
async def sync(map_id: MapId, wanted: SyncIn, service: ServiceDep) -> SyncOut:
    """What a client lacks of a version, what it has to replace and what to drop, page by page.

    A version that it holds and that is not kept any more counts for nothing: `base` is 0 then.
    """
    if wanted.version is not None and wanted.tiles is not None:
        raise ProtocolError(400, "bad-request", "say which version you hold, or which tiles, not both")
    choice = _choice(wanted.layers, None if wanted.bbox is None else ",".join(map(str, wanted.bbox)))

    def read(session: Session) -> SyncOut:
        number = maps.version(session, map_id, wanted.to).version
        if wanted.tiles is not None:
            base, held = None, {(one.layer, one.z, one.x, one.y): one.digest for one in wanted.tiles}
            found, end = version_diff.held_changes(session, map_id, number, held, choice, wanted.limit, _key(wanted.after))
        else:
            base = _known(session, map_id, wanted.version or NOTHING)
            found, end = version_diff.tile_changes(session, map_id, (base, number), choice, wanted.limit, _key(wanted.after))
        came, changed, gone = _sorted_out(found)
        return SyncOut(
            map_id=map_id, version=number, base=base, fetch_from=f"/v1/maps/{map_id}/versions/{number}/tiles/", next=_text(end),
            add=[TileToFetch(**_there(row), name=_name(_key_of(row))) for row in came],
            replace=[TileToFetch(**_there(row), name=_name(_key_of(row))) for row, _ in changed],
            drop=[TileToDrop(**_at(key), name=_name(key)) for key, _ in gone],
        )  # fmt: skip

    return await service.read(read)


def _check(session: Session, map_id: str, base: int, number: int) -> None:
    """Raises NotFoundError, WithdrawnError."""
    for one in (base, number):
        if one != NOTHING:
            maps.version(session, map_id, one)


def _known(session: Session, map_id: str, held: int) -> int:
    """The version that a client holds, 0 where it is not kept or is withdrawn."""
    try:
        return NOTHING if held == NOTHING else maps.version(session, map_id, held).version
    except NotFoundError:
        return NOTHING


def _choice(layers: Sequence[str] | None, bbox: str | None) -> TileChoice:
    unknown = sorted({*(layers or ())} - {*SERVED_LAYERS})
    if unknown:
        raise ProtocolError(400, "bad-request", f"there is no layer {unknown[0]!r}; there are {', '.join(SERVED_LAYERS)}")
    return TileChoice(tuple(sorted({*(SERVED_LAYERS if layers is None else layers)})), None if bbox is None else box_of_query(bbox))


def _sorted_out(
    found: Sequence[TileChange],
) -> tuple[list[TileRow], list[tuple[TileRow, str]], list[tuple[TileKey, str]]]:
    """Tiles that came, those that changed with the digests of before, and where which ones went."""
    there = [(one.after, one.before) for one in found if one.after is not None]
    came = [row for row, before in there if before is None]
    changed = [(row, before) for row, before in there if before is not None]
    return came, changed, [(one.key, one.before) for one in found if one.after is None and one.before is not None]


def _key_of(row: TileRow) -> TileKey:
    return row.layer, row.z, row.x, row.y


def _at(key: TileKey) -> dict[str, Any]:
    return dict(zip(("layer", "z", "x", "y"), key, strict=True))


def _there(row: TileRow) -> dict[str, Any]:
    return _at(_key_of(row)) | {"digest": row.digest, "bytes": row.size}


def _name(key: TileKey) -> str:
    layer, z, x, y = key
    return f"{layer}/{z}/{x}/{y}{SUFFIXES[layer]}"


def _region(key: RegionKey, before: RegionRow | None, now: RegionRow | None, frame: MapFrame) -> RegionDiff:
    box = region_box(key, frame, AROUND_M)
    return RegionDiff(east=key[0], north=key[1], bbox=box, before=_region_there(before), after=_region_there(now))


def _region_there(row: RegionRow | None) -> RegionThere | None:
    if row is None:
        return None
    files = {name: str(getattr(row, name)) for name in FILES_OF_REGION if getattr(row, name)}
    return RegionThere(digest=row.digest, bytes=row.size, inputs=row.inputs, files=files)


def _key(after: str | None) -> TileKey | None:
    if after is None:
        return None
    layer, z, x, y = after.split(",")
    return layer, int(z), int(x), int(y)


def _text(end: TileKey | None) -> str | None:
    return None if end is None else ",".join(map(str, end))
