"""Tables of rigs: what drives tell of them, and the versions of their files."""

from typing import Any

from sqlalchemy import ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from wayloom.store.tables.base import DIGEST, Base


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
