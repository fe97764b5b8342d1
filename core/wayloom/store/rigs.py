"""Repository of rigs: what their drives say of them, and the versions of their files.

Learning takes seconds and happens outside of any transaction. Every change of a rig's evidence raises its revision; what was learnt
from another revision is refused, and its writer reads and learns again. So two workers that bring evidence of one rig at once leave
what one after the other would have left.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import delete, func, select, update
from sqlalchemy.orm import Session

from wayloom.errors import ConflictError, NotFoundError
from wayloom.store.coming import note
from wayloom.store.database import now_s
from wayloom.store.tables.drives import Drive
from wayloom.store.tables.rigs import Rig, RigEvidence, RigVersion


@dataclass(frozen=True, slots=True)
class Evidence:
    """A row of `RigEvidence`, before its epoch is known."""

    drive_id: str
    digest: str
    own_digest: str
    t_ns: int
    scale: Mapping[str, Any] | None = None
    receiver: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class ByGnss:
    """What a drive's fixes say of its rig; the columns of `RigEvidence`."""

    scale: Mapping[str, Any] | None = None
    receiver: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True)
class EvidenceEpoch:
    """Which epoch a drive's evidence lies in; the columns of `RigEvidence`."""

    from_ns: int
    chi_square: float | None
    stray: bool


@dataclass(frozen=True, slots=True)
class NewRigVersion:
    """What learning writes; the columns of `RigVersion`."""

    from_ns: int
    evidence: str
    digest: str
    drives: tuple[str, ...]
    reason: str
    facts: Mapping[str, Any]


def rig_key(vehicle_id: str | None, rig_id: str | None) -> str | None:
    """The rig's id: of vehicle and rig as the log says; None where it says neither."""
    if vehicle_id is None and rig_id is None:
        return None
    return hashlib.sha256(json.dumps([vehicle_id, rig_id]).encode()).hexdigest()[:32]


def ensure(session: Session, vehicle_id: str | None, rig_id: str | None) -> Rig:
    """The rig of these names, made when it is not there. Raises ConflictError where there are none."""
    key = rig_key(vehicle_id, rig_id)
    if key is None:
        raise ConflictError("a log that names neither vehicle nor rig has no rig to remember")
    found = session.get(Rig, key)
    if found is None:
        found = Rig(id=key, vehicle_id=vehicle_id, rig_id=rig_id, revision=0, created_at=now_s(session))
        session.add(found)
        session.flush()
    return found


def get(session: Session, key: str) -> Rig:
    """The rig. Raises NotFoundError."""
    found = session.get(Rig, key)
    if found is None:
        raise NotFoundError(f"there is no rig {key[:80]!r}")
    return found


def all_rigs(session: Session) -> Sequence[Rig]:
    """Every rig, by its names."""
    return session.scalars(select(Rig).order_by(Rig.vehicle_id, Rig.rig_id, Rig.id)).all()


def evidence_of(session: Session, key: str) -> Sequence[RigEvidence]:
    """What the rig's drives say, by the time of recording; drives that are being removed say nothing any more."""
    query = (
        select(RigEvidence).join(Drive, Drive.id == RigEvidence.drive_id).where(RigEvidence.rig == key, Drive.state != "removing")
    )
    return session.scalars(query.order_by(RigEvidence.t_ns, RigEvidence.drive_id)).all()


def evidence_of_drive(session: Session, drive_id: str) -> RigEvidence | None:
    """What a drive says of its rig, if it does."""
    return session.get(RigEvidence, drive_id)


def versions(session: Session, key: str) -> Sequence[RigVersion]:
    """The versions of the rig's file, newest first."""
    return session.scalars(select(RigVersion).where(RigVersion.rig == key).order_by(RigVersion.version.desc())).all()


def version(session: Session, key: str, number: int | None = None) -> RigVersion:
    """A version, the newest by default. Raises NotFoundError."""
    found = (
        session.get(RigVersion, (key, number)) if number is not None else next(iter(versions(session, get(session, key).id)), None)
    )
    if found is None:
        raise NotFoundError(
            f"rig {key[:12]} has no version {number}" if number is not None else f"nothing is known of rig {key[:12]} yet"
        )
    return found


def version_for(session: Session, key: str, t_ns: int) -> RigVersion | None:
    """The newest version that holds for a drive recorded at t_ns: of the epoch that had begun then, or else of the first one."""
    epochs = {row.from_ns for row in evidence_of(session, key) if not row.stray}
    made = {found.from_ns: found for found in reversed(versions(session, key)) if found.from_ns in epochs}
    begun = [from_ns for from_ns in made if from_ns <= t_ns] or sorted(made)[:1]
    return made[max(begun)] if begun else None


def write(
    session: Session, key: str, revision: int, epochs: Mapping[str, EvidenceEpoch], new: Sequence[NewRigVersion],
    added: Sequence[Evidence] = (), by_gnss: Mapping[str, ByGnss] | None = None,
) -> bool:  # fmt: skip
    """Put evidence, its epochs and new versions down as one. False, and nothing is written, where the rig's revision is another.

    epochs : of every drive that counts, those of `added` included; rows of other drives are forgotten
    """
    changed = update(Rig).where(Rig.id == key, Rig.revision == revision).values(revision=revision + 1).returning(Rig.id)
    if not session.execute(changed).all():
        return False
    session.execute(delete(RigEvidence).where(RigEvidence.rig == key, RigEvidence.drive_id.not_in(list(epochs))))
    for one in added:
        of = epochs[one.drive_id]
        session.add(RigEvidence(
            drive_id=one.drive_id, rig=key, digest=one.digest, own_digest=one.own_digest, t_ns=one.t_ns, scale=one.scale,
            receiver=one.receiver, from_ns=of.from_ns, chi_square=of.chi_square, stray=of.stray,
        ))  # fmt: skip
    session.flush()
    for row in session.scalars(select(RigEvidence).where(RigEvidence.rig == key)):
        of = epochs[row.drive_id]
        row.from_ns, row.chi_square, row.stray = of.from_ns, of.chi_square, of.stray
        said = (by_gnss or {}).get(row.drive_id, ByGnss())
        row.scale = dict(said.scale or row.scale or {}) or None
        row.receiver = dict(said.receiver or row.receiver or {}) or None
    number, now = _newest_number(session, key), now_s(session)
    for count, made in enumerate(new, start=1):
        session.add(RigVersion(
            rig=key, version=number + count, from_ns=made.from_ns, evidence=made.evidence, digest=made.digest,
            drives=list(made.drives), reason=made.reason, facts=dict(made.facts), created_at=now,
        ))  # fmt: skip
    return True


def has_file(session: Session, key: str, digest: str) -> bool:
    """Whether a version of the rig's file has these bytes; those that were learnt from a removed drive are gone."""
    return session.scalars(select(RigVersion.digest).where(RigVersion.rig == key, RigVersion.digest == digest)).first() is not None


def _newest_number(session: Session, key: str) -> int:
    """The greatest number of a version so far: of those that are gone, as far as a drive was tracked with them."""
    used = Drive.facts["rig"]["version"].as_integer()
    by_drives = session.scalar(select(func.max(used)).where(Drive.facts["rig"]["rig"].as_string() == key))
    return max(session.scalar(select(func.max(RigVersion.version)).where(RigVersion.rig == key)) or 0, by_drives or 0)


def use(session: Session, drive_id: str, about: Mapping[str, Any] | None) -> None:
    """Remember which version a drive is tracked with."""
    note(session.get_one(Drive, drive_id), rig=None if about is None else dict(about))
