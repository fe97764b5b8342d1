"""Tables of the database. Times are seconds since 1970 as float; digests are 64 hexadecimal characters of SHA-256."""

from typing import Any

from sqlalchemy import (
    JSON,
    BigInteger,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Text,
    UniqueConstraint,
    text,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}
DIGEST = String(64)


class Base(DeclarativeBase):
    """Parent of every table."""

    metadata = MetaData(naming_convention=NAMING)
    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it from the class
        int: BigInteger().with_variant(Integer, "sqlite"),
        float: Float(53),
        dict[str, Any]: JSON(),
        list[Any]: JSON(),
        bytes: LargeBinary(),
    }


def _ended(table: str) -> Index:
    """Of rows that versions share, those that a version has ended. The others are found by their keys."""
    ended = text("until IS NOT NULL")
    return Index(f"ix_{table}_until", "map_id", "until", sqlite_where=ended, postgresql_where=ended)


class Vehicle(Base):
    """A vehicle that has sent at least one drive."""

    __tablename__ = "vehicles"
    id: Mapped[str] = mapped_column(String(128), primary_key=True)
    created_at: Mapped[float]


class Drive(Base):
    """One drive of one vehicle: its manifest, and how far it is.

    state    uploading, queued, running, stitching, done, held, quarantined, failed, removing
    placed   whether it has a place on Earth (None until the geo-reference is done)
    grade    A to E by the geo-reference (None: without a place, or not judged yet), and its reasons in words
    gate     merge, hold or quarantine (None until the drive is judged); only `merge` and released drives are in the map
    released_at, released_by, released_why  an operator's word that a held or quarantined drive is merged all the same
    """

    __tablename__ = "drives"
    id: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    name: Mapped[str] = mapped_column(String(256))
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicles.id"), index=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id"), index=True)
    manifest: Mapped[dict[str, Any]]
    file_count: Mapped[int]
    byte_count: Mapped[int]
    state: Mapped[str] = mapped_column(String(16), index=True)
    error: Mapped[str | None] = mapped_column(Text)
    placed: Mapped[bool | None]
    grade: Mapped[str | None] = mapped_column(String(1))
    gate: Mapped[str | None] = mapped_column(String(16))
    reasons: Mapped[list[Any] | None]
    released_at: Mapped[float | None]
    released_by: Mapped[str | None] = mapped_column(String(128))
    released_why: Mapped[str | None] = mapped_column(Text)
    facts: Mapped[dict[str, Any]] = mapped_column(default=dict)
    track: Mapped[list[Any] | None]
    stitch_job_id: Mapped[int | None]
    created_at: Mapped[float] = mapped_column(index=True)
    uploaded_at: Mapped[float | None]
    finished_at: Mapped[float | None]


class DriveFile(Base):
    """A file that a drive's manifest promises; `complete` once it lies in the drive's folder with the promised digest."""

    __tablename__ = "drive_files"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    path: Mapped[str] = mapped_column(String(1024), primary_key=True)
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(DIGEST)
    complete: Mapped[bool] = mapped_column(default=False)


class Upload(Base):
    """A tus upload of one file. Its offset stands nowhere: it is the size of the stored bytes."""

    __tablename__ = "uploads"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), index=True)
    path: Mapped[str] = mapped_column(String(1024))
    length: Mapped[int]
    metadata_header: Mapped[str] = mapped_column(Text)
    complete: Mapped[bool] = mapped_column(default=False)
    expires_at: Mapped[float] = mapped_column(index=True)


class Job(Base):
    """One stage of one drive or map. The row is the truth; a message only wakes a worker.

    state   waiting (for the stage before it), queued, running, done, failed
    token   fencing token: grows with every claim; whoever holds an older one may not commit
    part    0: the whole stage; a stage that is made in parts has a row for each, from 1 on, and its own waits for them
    worker  who runs it: host, boot, process id and start time
    """

    __tablename__ = "jobs"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    drive_id: Mapped[str | None] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"))
    map_id: Mapped[str | None] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"))
    parent_id: Mapped[int | None] = mapped_column(index=True)
    stage: Mapped[str] = mapped_column(String(32))
    part: Mapped[int] = mapped_column(default=0, server_default="0")
    position: Mapped[int]
    queue: Mapped[str] = mapped_column(String(32))
    state: Mapped[str] = mapped_column(String(16))
    attempt: Mapped[int] = mapped_column(default=0)
    token: Mapped[int] = mapped_column(default=0)
    worker: Mapped[str | None] = mapped_column(String(256))
    lease_until: Mapped[float | None]
    heartbeat_at: Mapped[float | None]
    sent_at: Mapped[float | None]
    progress: Mapped[float] = mapped_column(default=0.0)
    message: Mapped[str] = mapped_column(Text, default="")
    error: Mapped[str | None] = mapped_column(Text)
    payload: Mapped[dict[str, Any]] = mapped_column(default=dict)
    created_at: Mapped[float]
    started_at: Mapped[float | None]
    finished_at: Mapped[float | None]
    __table_args__ = (
        UniqueConstraint("drive_id", "stage", "part"),
        Index("ix_jobs_state_sent_at", "state", "sent_at"),
        Index("ix_jobs_map_id_stage_state", "map_id", "stage", "state"),
    )


class SubmapRow(Base):
    """A submap's place; its points are the blob `digest`. The box is in degrees, around its points and its track, for look-up.

    track   (K, 2) longitude and latitude of its keyframes, and when the first of them was taken (`track_t_ns`)
    """

    __tablename__ = "submaps"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id"), index=True)
    digest: Mapped[str] = mapped_column(DIGEST)
    point_count: Mapped[int]
    frame: Mapped[list[Any]]
    T_enu_submap: Mapped[list[Any]]
    covariance: Mapped[list[Any]]
    track: Mapped[list[Any]] = mapped_column(default=list)
    track_t_ns: Mapped[int] = mapped_column(default=0)
    min_lon: Mapped[float]
    min_lat: Mapped[float]
    max_lon: Mapped[float]
    max_lat: Mapped[float]
    __table_args__ = (Index("ix_submaps_box", "map_id", "min_lon", "max_lon", "min_lat", "max_lat"),)


class Rig(Base):
    """A stereo rig as its drives name it; at least one of the two names is there.

    revision  grows with every change of its evidence: what is learnt from an older one is not written
    """

    __tablename__ = "rigs"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    vehicle_id: Mapped[str | None] = mapped_column(String(128))
    rig_id: Mapped[str | None] = mapped_column(String(256))
    revision: Mapped[int] = mapped_column(default=0)
    created_at: Mapped[float]


class RigEvidence(Base):
    """What a drive says of its rig. It outlives the drive's images, and goes with the drive.

    digest      of the blob of its calibration observations; own_digest of the rig file that these alone give
    t_ns        when the drive was recorded, or, where its log does not say, registered
    scale       what GNSS says of the drive's length (`wayloom.calibration.baseline.ScaleByGnss`)
    receiver    what the drive says of GNSS clock and lever arm (`wayloom.calibration.receiver.ReceiverEvidence`)
    from_ns     when the epoch that it lies in began
    chi_square  by which it contradicts the epoch before, where it began one; stray: where it agrees with none
    """

    __tablename__ = "rig_evidence"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.id"), index=True)
    digest: Mapped[str] = mapped_column(DIGEST)
    own_digest: Mapped[str] = mapped_column(DIGEST)
    t_ns: Mapped[int]
    scale: Mapped[dict[str, Any] | None]
    receiver: Mapped[dict[str, Any] | None]
    from_ns: Mapped[int]
    chi_square: Mapped[float | None]
    stray: Mapped[bool] = mapped_column(default=False)


class RigVersion(Base):
    """One state of a rig's file. Never changed after it is written.

    from_ns   when the epoch of drives that it was learnt from began
    evidence  digest of that evidence: the same evidence is not learnt from again
    digest    of the blob, a RIG.toml
    drives    ids of the drives that it was learnt from
    reason    why it was made
    facts     the numbers with their sigmas
    """

    __tablename__ = "rig_versions"
    rig: Mapped[str] = mapped_column(ForeignKey("rigs.id"), primary_key=True)
    version: Mapped[int] = mapped_column(primary_key=True)
    from_ns: Mapped[int]
    evidence: Mapped[str] = mapped_column(DIGEST)
    digest: Mapped[str] = mapped_column(DIGEST, index=True)
    drives: Mapped[list[Any]]
    reason: Mapped[str] = mapped_column(String(64))
    facts: Mapped[dict[str, Any]]
    created_at: Mapped[float]


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


class TileRow(Base):
    """Where the bytes of a tile are: the digest is the blob's name and the tile's ETag.

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
    __table_args__ = (_ended("regions"),)


class MapDrive(Base):
    """A drive that versions of a map hold; `since` and `until` as in `TileRow`. It outlives the drive, as those versions do."""

    __tablename__ = "map_drives"
    map_id: Mapped[str] = mapped_column(String(63), primary_key=True)
    drive_id: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    since: Mapped[int] = mapped_column(primary_key=True)
    until: Mapped[int | None]
    __table_args__ = (_ended("map_drives"),)


class ChangedBox(Base):
    """A place where submaps came, went or moved since the map was stitched; degrees, as in `SubmapRow`. The version that has taken
    it in drops it."""

    __tablename__ = "changed_boxes"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id", ondelete="CASCADE"), index=True)
    min_lon: Mapped[float]
    min_lat: Mapped[float]
    max_lon: Mapped[float]
    max_lat: Mapped[float]
