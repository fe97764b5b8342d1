"""Lineage of places of a map version: the regions there, and the drives, submaps and runs that they were made from."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from wayloom.store import runs
from wayloom.store.map_versions import RegionKey
from wayloom.store.maps import of_version
from wayloom.store.tables.drives import Drive, DriveRun
from wayloom.store.tables.maps import MapVersion, RegionRow


@dataclass(frozen=True, slots=True)
class DriveOrigin:
    """A drive whose submaps bear on a place.

    drive    None of one that is being removed
    submaps  their digests, sorted
    run      what made them; None of a drive that was processed before runs were kept
    """

    drive_id: str
    drive: Drive | None
    submaps: tuple[str, ...]
    run: DriveRun | None


def regions_of_version(session: Session, version: MapVersion, keys: Iterable[RegionKey] | None) -> Sequence[RegionRow]:
    """Those of a version among the regions of a rectangle of keys, or all, by column and row."""
    if keys is None:
        every = select(RegionRow).where(RegionRow.map_id == version.map_id, of_version(RegionRow, version.version))
        return session.scalars(every.order_by(RegionRow.east, RegionRow.north)).all()
    wanted = {*keys}
    if not wanted:
        return []
    (west, south), (east, north) = (tuple(side(part) for part in zip(*wanted, strict=True)) for side in (min, max))
    here = (RegionRow.map_id == version.map_id, RegionRow.east.between(west, east), RegionRow.north.between(south, north))
    rows = select(RegionRow).where(*here, of_version(RegionRow, version.version)).order_by(RegionRow.east, RegionRow.north)
    return [row for row in session.scalars(rows) if (row.east, row.north) in wanted]


def origins(session: Session, version: MapVersion, regions: Sequence[RegionRow]) -> list[DriveOrigin]:
    """What the regions of a version were made from, by drive."""
    members: dict[str, set[str]] = {}
    for region in regions:
        for drive_id, digest in region.members:
            members.setdefault(drive_id, set()).add(digest)
    made = runs.of_drives(session, members)
    found = []
    for drive_id, digests in sorted(members.items()):
        submaps = tuple(sorted(digests))
        run = runs.that_made(made[drive_id], submaps[0], version.created_at)
        found.append(DriveOrigin(drive_id, session.get(Drive, drive_id), submaps, run))
    return found
