"""Tables of drives: their files, uploads, jobs, runs and submaps."""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, Text, UniqueConstraint, false, true
from sqlalchemy.orm import Mapped, mapped_column

from wayloom.store.tables.base import DIGEST, Base


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
    """A file that a drive's manifest promises; `complete` once it lies in its place with the promised digest.

    upload_id, upload_start  of a file in an object store, the upload whose parts hold it, and at which of their bytes it begins;
                             None where it lies in the drive's folder
    """

    __tablename__ = "drive_files"
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), primary_key=True)
    path: Mapped[str] = mapped_column(String(1024), primary_key=True)
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(DIGEST)
    complete: Mapped[bool] = mapped_column(default=False)
    upload_id: Mapped[str | None] = mapped_column(String(32))
    upload_start: Mapped[int | None]


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


class UploadPart(Base):
    """Bytes of an upload from `start` on, in an object store: what stands here has arrived, what lies there alone has not.

    It outlives the row of its upload, for the drive's files are read from it.
    """

    __tablename__ = "upload_parts"
    upload_id: Mapped[str] = mapped_column(String(32), primary_key=True)
    start: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), index=True)
    length: Mapped[int]
    name: Mapped[str] = mapped_column(String(256))


class Job(Base):
    """One stage of one drive or map. The row is the truth; a message only wakes a worker.

    state   waiting (for the stage before it), queued, running, done, failed
    token   fencing token: grows with every claim; whoever holds an older one may not commit
    part    0: the whole stage; a stage that is made in parts has a row for each, from 1 on, and its own waits for them
    worker  who runs it: host, boot, process id and start time
    attempt     how often it was begun, less those that ended through no fault of the stage
    losses      workers that died or fell silent while they ran it, without a crash of its own: evidence, one entry each
    not_before  when it may be tried again (None: at once)
    heartbeat_at  when its worker last gave a sign of life; of a job that pauses, when its pause began
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


class DriveEvent(Base):
    """An entry of a drive's history (`wayloom.store.history`). part : 0, or the stage's part. text : error or evidence."""

    __tablename__ = "drive_events"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    drive_id: Mapped[str] = mapped_column(ForeignKey("drives.id", ondelete="CASCADE"), index=True)
    at: Mapped[float]
    stage: Mapped[str] = mapped_column(String(32))
    part: Mapped[int]
    attempt: Mapped[int]
    what: Mapped[str] = mapped_column(String(16))
    text: Mapped[str] = mapped_column(Text)
    worker: Mapped[str | None] = mapped_column(String(256))


class DriveEstimate(Base):
    """Remaining time of a drive as it was told when a stage began (`wayloom.store.etas`). Of a removed drive it stays, nameless.

    expected_s     the plain estimate; low_s, high_s the interval around it
    rough          a stage to come had never been seen
    truth_s        how long it took until the drive was finished; None until then
    """

    __tablename__ = "drive_estimates"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    drive_id: Mapped[str | None] = mapped_column(ForeignKey("drives.id", ondelete="SET NULL"), index=True)
    at: Mapped[float]
    stage: Mapped[str] = mapped_column(String(32))
    expected_s: Mapped[float]
    low_s: Mapped[float]
    high_s: Mapped[float]
    rough: Mapped[bool]
    truth_s: Mapped[float | None]


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
