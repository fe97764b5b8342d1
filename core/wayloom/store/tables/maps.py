"""Tables of maps: versions, what they share (tiles, regions, drives), meetings, changes, excluded areas, blobs to drop."""

from typing import Any

from sqlalchemy import ForeignKey, Index, String, false, text
from sqlalchemy.orm import Mapped, mapped_column

from wayloom.store.tables.base import DIGEST, Base


def _ended(table: str) -> Index:
    """Of rows that versions share, those that a version has ended. The others are found by their keys."""
    ended = text("until IS NOT NULL")
    return Index(f"ix_{table}_until", "map_id", "until", sqlite_where=ended, postgresql_where=ended)


class Map(Base):
    """A map; `version` is the pointer that publishing flips (0: nothing published yet)."""

    __tablename__ = "maps"
    id: Mapped[str] = mapped_column(String(63), primary_key=True)
    version: Mapped[int] = mapped_column(default=0)
    created_at: Mapped[float]


class MapVersion(Base):
    """One published state of a map. Never changed after it is written.

    layers      for each layer its media type and, by zoom, how many tiles it has
    built_with  digest of the settings, the code and the frame that its regions and tiles were made with
    withdrawn_at  since when it is not served any more, because it held a drive that was removed
    """

    __tablename__ = "map_versions"
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    created_at: Mapped[float]
    frame: Mapped[list[Any]]
    built_with: Mapped[str] = mapped_column(DIGEST, default="")
    submap_count: Mapped[int]
    drive_count: Mapped[int]
    bounds: Mapped[list[Any] | None]
    layers: Mapped[dict[str, Any]]
    tile_count: Mapped[int]
    byte_count: Mapped[int]
    facts: Mapped[dict[str, Any]] = mapped_column(default=dict)
    withdrawn_at: Mapped[float | None]


class TileRow(Base):
    """Where the bytes of a tile are: the digest is the blob's name and the tile's ETag; empty where all its versions are withdrawn.

    since, until   it is part of the versions from `since` on and before `until`; None: of the newest too. So versions share the
                   rows of what did not change between them.
    """

    __tablename__ = "tiles"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    layer: Mapped[str] = mapped_column(String(32), primary_key=True)
    z: Mapped[int] = mapped_column(primary_key=True)
    x: Mapped[int] = mapped_column(primary_key=True)
    y: Mapped[int] = mapped_column(primary_key=True)
    since: Mapped[int] = mapped_column(primary_key=True)
    until: Mapped[int | None]
    digest: Mapped[str] = mapped_column(DIGEST)
    media_type: Mapped[str] = mapped_column(String(64))
    size: Mapped[int]
    __table_args__ = (Index("ix_tiles_since", "map_id", "since"), _ended("tiles"))


class RegionRow(Base):
    """The merged voxels of one region of a map; `since` and `until` as in `TileRow`.

    east, north  its column and row in the grid of the map's frame
    inputs       digest of the submaps, places, settings and code that it was made from: the same inputs make no new region
    members      which submaps these are: [drive id, digest of the submap]
    changes      what has gone from it and is new, as `RegionEntry.changes`; change_count how many
    ground       digest of its ground (docs/formats.md), empty where it has none
    markings     digest of its markings and kerbs (docs/formats.md), empty where it has none: of its ground and that around it
    areas        digest of its areas, likewise
    objects      digest of its objects, as features, empty where it has none
    """

    __tablename__ = "regions"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    east: Mapped[int] = mapped_column(primary_key=True)
    north: Mapped[int] = mapped_column(primary_key=True)
    since: Mapped[int] = mapped_column(primary_key=True)
    until: Mapped[int | None]
    inputs: Mapped[str] = mapped_column(DIGEST)
    digest: Mapped[str] = mapped_column(DIGEST)
    members: Mapped[list[Any]]
    size: Mapped[int]
    changes: Mapped[list[Any]] = mapped_column(server_default="[]")
    change_count: Mapped[int] = mapped_column(server_default="0")
    ground: Mapped[str] = mapped_column(DIGEST, server_default="")
    markings: Mapped[str] = mapped_column(DIGEST, server_default="")
    areas: Mapped[str] = mapped_column(DIGEST, server_default="")
    objects: Mapped[str] = mapped_column(DIGEST, server_default="")
    __table_args__ = (_ended("regions"),)


class MapDrive(Base):
    """A drive that versions of a map hold; `since` and `until` as in `TileRow`.

    removed  the drive is no more: the row stays until the versions that hold it are withdrawn
    """

    __tablename__ = "map_drives"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    drive_id: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    since: Mapped[int] = mapped_column(primary_key=True)
    until: Mapped[int | None]
    removed: Mapped[bool] = mapped_column(default=False, server_default=false())
    __table_args__ = (_ended("map_drives"),)


class ChangedBox(Base):
    """A place where submaps of a drive came, went or moved since the map was stitched; degrees, as in `SubmapRow`, NULL where the
    submap has no place. The version that has taken it in drops it."""

    __tablename__ = "changed_boxes"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    drive_id: Mapped[str] = mapped_column(DIGEST)
    min_lon: Mapped[float | None]
    min_lat: Mapped[float | None]
    max_lon: Mapped[float | None]
    max_lat: Mapped[float | None]


class MeetingRow(Base):
    """What the registration of two drives found; kept for as long as both are what they were.

    inputs  digest of both drives' submaps and places, the frame, the settings and the code
    digest  of the blob, a file of meetings (docs/formats.md), empty where they were not compared; count: how many there are
    likeness  how much of one without a place of its own is like the other; NULL where both have places
    """

    __tablename__ = "meetings"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    drive_a: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    drive_b: Mapped[str] = mapped_column(DIGEST, primary_key=True, index=True)
    inputs: Mapped[str] = mapped_column(DIGEST)
    digest: Mapped[str] = mapped_column(DIGEST)
    count: Mapped[int]
    likeness: Mapped[float | None]


class ExcludedArea(Base):
    """An area of a map of which nothing is kept. Never changed after it is written.

    geometry  GeoJSON, a Polygon or MultiPolygon; the box around it in degrees, across the antimeridian with max_lon over 180
    source    service: it was asked for over HTTP; settings: it stands in the file that `excluded_areas` names
    since     the first version that was made without what lies in it; None: that is yet to come
    """

    __tablename__ = "excluded_areas"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    name: Mapped[str] = mapped_column(String(256))
    geometry: Mapped[dict[str, Any]]
    min_lon: Mapped[float]
    min_lat: Mapped[float]
    max_lon: Mapped[float]
    max_lat: Mapped[float]
    source: Mapped[str] = mapped_column(String(16))
    created_at: Mapped[float]
    since: Mapped[int | None]


class ForgottenBlob(Base):
    """A blob that held something of a removed drive: it is deleted as soon as nothing names it.

    stage  whose jobs store such blobs: while one runs it may have found this one stored, and be about to name it
    """

    __tablename__ = "forgotten_blobs"
    digest: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    stage: Mapped[str] = mapped_column(String(32))
