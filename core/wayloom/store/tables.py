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
    false,
    text,
    true,
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
    owner    the vehicle or key that announced it (`wayloom.store.access.owners`), None of admins and operators
    placed   whether it has a place on Earth (None until the geo-reference is done)
    grade    A to E by the geo-reference (None: without a place, or not judged yet), and its reasons in words
    gate     merge, hold or quarantine (None until the drive is judged), by that grade
    sound    whether at most the place is in doubt (None: judged before that was told): a sound drive that is held is a guest, asked
             at every stitch whether its meetings with the map's drives place it
    admitted, map_verdict  of a guest: whether the newest version has it, and `wayloom.stitching.admission.Verdict` as JSON
             In the map are drives of the gate `merge`, released and admitted ones.
    released_at, released_by, released_why  an operator's word that a held or quarantined drive is merged all the same
    images   kept, deleting, deleted, returning (`wayloom.store.images`); images_since when that began, where it is told
    coming   while it is processed anew: what was asked for and what the new run has found (`wayloom.store.reprocessing`)
    """

    __tablename__ = "drives"
    id: Mapped[str] = mapped_column(DIGEST, primary_key=True)
    name: Mapped[str] = mapped_column(String(256))
    vehicle_id: Mapped[str | None] = mapped_column(ForeignKey("vehicles.id"), index=True)
    owner: Mapped[str | None] = mapped_column(String(160), index=True)
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
    sound: Mapped[bool | None]
    admitted: Mapped[bool] = mapped_column(default=False, server_default=false())
    map_verdict: Mapped[dict[str, Any] | None]
    released_at: Mapped[float | None]
    released_by: Mapped[str | None] = mapped_column(String(128))
    released_why: Mapped[str | None] = mapped_column(Text)
    facts: Mapped[dict[str, Any]] = mapped_column(default=dict)
    track: Mapped[list[Any] | None]
    stitch_job_id: Mapped[int | None]
    coming: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    images: Mapped[str] = mapped_column(String(16), default="kept", server_default="kept", index=True)
    images_since: Mapped[float | None]
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
    """A tus upload of one file, or of a pack of them. Its offset stands nowhere: it is the size of the stored bytes.

    path        the file's; '' of a pack, whose files stand in its index beside the bytes (`wayloom.store.packs`)
    files_done  of a pack, how many of its files are in their places, in its order (None: an upload of one file)
    """

    __tablename__ = "uploads"
    id: Mapped[str] = mapped_column(String(32), primary_key=True)
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), index=True)
    path: Mapped[str] = mapped_column(String(1024))
    length: Mapped[int]
    metadata_header: Mapped[str] = mapped_column(Text)
    complete: Mapped[bool] = mapped_column(default=False)
    expires_at: Mapped[float] = mapped_column(index=True)
    files_done: Mapped[int | None]


class Job(Base):
    """One stage of one drive or map. The row is the truth; a message only wakes a worker.

    state   waiting (for the stage before it), queued, running, done, failed
    token   fencing token: grows with every claim; whoever holds an older one may not commit
    part    0: the whole stage; a stage that is made in parts has a row for each, from 1 on, and its own waits for them
    worker  who runs it: host, boot, process id and start time
    attempt     how often it was begun, less those that ended through no fault of the stage
    losses      workers that died or fell silent while they ran it, without a crash of its own: evidence, one entry each
    not_before  when it may be tried again (None: at once)
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
    losses: Mapped[list[Any]] = mapped_column(default=list, server_default="[]")
    not_before: Mapped[float | None]
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


class DriveRun(Base):
    """One way of a drive through its stages: what made the submaps that it had in the map. Never changed after it is written.

    stages   for each stage the key, digest, code, libraries, inputs and parameters of its stage.json
    submaps  digests of the submaps that it made, in the order of the road
    asked    the settings that were asked for instead of the service's
    """

    __tablename__ = "drive_runs"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True)
    stages: Mapped[dict[str, Any]]
    submaps: Mapped[list[Any]]
    asked: Mapped[dict[str, Any]]
    created_at: Mapped[float]


class SubmapRow(Base):
    """A submap's place in the map; its points are the blob `digest`. The box is in degrees, around points and track, for look-up;
    the database keeps a spatial index of both boxes (`wayloom.store.spatial.derived`).

    located                           whether the drive's own geo-reference places it; where it does not, own_T_enu_submap is in the
                                      drive's own level frame, and frame and box are NULL, which no box touches, until a version has
                                      the drive by its meetings
    T_enu_submap, covariance          where the newest version has it: by the city graph where the drive meets others
    own_T_enu_submap, own_covariance  by the drive's own geo-reference; [] in rows older than the city graph: the same
    step_before  what joins it to the one before by the drive's own geo-reference, `wayloom.submaps.submap.StepBefore`; none for the
                 first, and in rows older than this
    clipped_with  digest of the excluded areas nearby and of the place with which it was clipped last; empty: it was not
    length_m  of road
    track   (K, 2) longitude and latitude of its keyframes, and when the first of them was taken (`track_t_ns`)
    near_*  box by the drive's own place, as wide as that is uncertain: drives whose boxes touch may have seen the same street. It
            never moves, so which drives are compared depends on the two alone.
    """

    __tablename__ = "submaps"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)
    map_id: Mapped[str] = mapped_column(ForeignKey("maps.id"), index=True)
    digest: Mapped[str] = mapped_column(DIGEST, index=True)
    point_count: Mapped[int]
    located: Mapped[bool] = mapped_column(default=True, server_default=true())
    frame: Mapped[list[Any] | None] = mapped_column(JSON(none_as_null=True))
    T_enu_submap: Mapped[list[Any]]
    covariance: Mapped[list[Any]]
    own_T_enu_submap: Mapped[list[Any]] = mapped_column(default=list)
    own_covariance: Mapped[list[Any]] = mapped_column(default=list)
    clipped_with: Mapped[str] = mapped_column(DIGEST, default="", server_default="")
    step_before: Mapped[dict[str, Any] | None] = mapped_column(JSON(none_as_null=True))
    length_m: Mapped[float] = mapped_column(default=0.0)
    track: Mapped[list[Any]] = mapped_column(default=list)
    track_t_ns: Mapped[int] = mapped_column(default=0)
    min_lon: Mapped[float | None]
    min_lat: Mapped[float | None]
    max_lon: Mapped[float | None]
    max_lat: Mapped[float | None]
    near_min_lon: Mapped[float | None]
    near_min_lat: Mapped[float | None]
    near_max_lon: Mapped[float | None]
    near_max_lat: Mapped[float | None]


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
