"""Rig memory of the service: which version of its rig's file a drive is tracked with, and what its evidence makes of the rig.

`remember` is called when a drive is tracked, `remember_gnss` when it is geo-referenced, `forget` when it is removed. Each learns
the rig anew from the evidence that there is and writes evidence and versions as one (`wayloom.store.rigs.write`); what is there
already is not written again, so a stage that is repeated changes nothing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import structlog

from wayloom.calibration import memory
from wayloom.calibration.baseline import ScaleByGnss
from wayloom.calibration.epochs import Epoch
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.memory import RememberedDrive
from wayloom.calibration.receiver import ReceiverEvidence, begins_epoch, receiver_facts
from wayloom.calibration.report import rig_facts
from wayloom.calibration.rig_file import RigFile, rig_for_log, rig_from_text, text_of
from wayloom.calibration.scale import scale_facts
from wayloom.calibration.settings import CalibrationSettings, with_bias_sigma
from wayloom.errors import StageError
from wayloom.georeference.files import GEOREFERENCE_FILE, load_georeference
from wayloom.georeference.receiver_report import receiver_by_drive
from wayloom.georeference.scale_prior import scale_by_gnss
from wayloom.logs.types import DriveLog
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.odometry.rig.calibration_file import load_observations, observations_from_bytes
from wayloom.pipeline.digests import sha256_of_json
from wayloom.pipeline.stages.odometry import EVIDENCE_FILE
from wayloom.store import drives, rigs
from wayloom.store.blobs import BlobStore
from wayloom.store.coming import facts_of
from wayloom.store.database import Database
from wayloom.store.rigs import ByGnss, Evidence, EvidenceEpoch, NewRigVersion
from wayloom_workers.stage_hooks import RepeatStageError, StageAttempt

log = structlog.get_logger()
RIG_FILE: Final = "rig.toml"
ROUNDS: Final = 50
"""How often a rig may change under the hands of who learns it."""
YEAR_2000_NS: Final = 946_684_800 * 10**9
"""Stamps before are no dates: many formats count from zero."""


def rig_file_for(attempt: StageAttempt, drive_log: DriveLog) -> Path | None:
    """The file to track the drive with: the setting's, or else the version that is the newest when this is first asked."""
    settings = attempt.context.settings
    if not settings.rig_memory or rig_for_log(settings.rig, drive_log)[0] is not None:
        return settings.rig
    pin = _pinned(attempt, drive_log)
    if pin is None or pin["sha256"] is None:
        return settings.rig
    file = attempt.inputs_dir.parent / RIG_FILE
    file.write_bytes(attempt.context.blobs.get(str(pin["sha256"])))
    return file


def remember(attempt: StageAttempt, drive_log: DriveLog) -> None:
    """Give the rig what the drive says of it. Raises RepeatStageError where that shows that it was tracked with the wrong file."""
    drive_id, context = str(attempt.claim.drive_id), attempt.context
    observations = load_observations(attempt.out_dir / EVIDENCE_FILE)
    key = _ensure(attempt, drive_log)
    if key is None or not context.settings.rig_memory or observations.groups < CalibrationSettings().least_groups:
        return
    with context.database.read() as session:
        known = rigs.evidence_of_drive(session, drive_id)
    if known is None:  # the first word counts, so that a repeated stage changes nothing
        digest = context.blobs.put((attempt.out_dir / EVIDENCE_FILE).read_bytes())
        own = context.blobs.put(text_of(learn_rig([observations]).rig).encode())
        learn_anew(context.database, context.blobs, key, Evidence(drive_id, digest, own, _recorded_ns(attempt, drive_log)))
    _check_version(attempt, key)


def remember_gnss(attempt: StageAttempt) -> None:
    """Give the rig what GNSS says of the drive's length, and the drive of its receiver, where either says anything."""
    drive_id, context = str(attempt.claim.drive_id), attempt.context
    with context.database.read() as session:
        known = rigs.evidence_of_drive(session, drive_id)
    if known is None or known.scale is not None or known.receiver is not None:
        return
    odometry = load_odometry(attempt.inputs_dir / "odometry" / ODOMETRY_FILE)
    geo = load_georeference(attempt.out_dir / GEOREFERENCE_FILE)
    scale = scale_by_gnss(geo.report, odometry.report, context.settings.georeference)
    receiver = receiver_by_drive(geo.report) if context.settings.rig_memory else None
    if scale is not None or receiver is not None:
        learn_anew(context.database, context.blobs, known.rig, by_gnss={drive_id: ByGnss(scale, receiver)})


def forget(attempt: StageAttempt) -> None:
    """Learn the drive's rig anew without it; the drive is marked as being removed."""
    with attempt.context.database.read() as session:
        known = rigs.evidence_of_drive(session, str(attempt.claim.drive_id))
    if known is not None:
        learn_anew(attempt.context.database, attempt.context.blobs, known.rig)


def learn_anew(
    database: Database, blobs: BlobStore, key: str, added: Evidence | None = None,
    by_gnss: Mapping[str, ByGnss] | None = None,
) -> None:  # fmt: skip
    """Write what the rig's evidence says, with a drive, or with what fixes say. Raises StageError where it never stands still."""
    for _ in range(ROUNDS):
        with database.read() as session:
            revision, rows, made = rigs.get(session, key).revision, rigs.evidence_of(session, key), rigs.versions(session, key)
        evidence = [Evidence(row.drive_id, row.digest, row.own_digest, row.t_ns, row.scale, row.receiver) for row in rows]
        new = [added] if added is not None and added.drive_id not in {one.drive_id for one in evidence} else []
        evidence = [_with_gnss(one, (by_gnss or {}).get(one.drive_id, ByGnss())) for one in (*evidence, *new)]
        epochs = memory.split_epochs([_remembered(blobs, one) for one in evidence])
        newest = {version.from_ns: version.evidence for version in reversed(made)}
        found = [_version(blobs, epoch, evidence, newest) for epoch in epochs if _is_new(epoch, evidence, newest)]
        of_drive = {name: EvidenceEpoch(epoch.from_ns, epoch.chi_square, epoch.stray) for epoch in epochs for name in epoch.ids}
        with database.write() as session:
            if rigs.write(session, key, revision, of_drive, found, new, by_gnss):
                return
    raise StageError(f"rig {key[:12]} has changed {ROUNDS} times while it was learnt")


def _is_new(epoch: Epoch[RememberedDrive], evidence: Sequence[Evidence], newest: Mapping[int, str]) -> bool:
    return not epoch.stray and newest.get(epoch.from_ns) != _evidence_digest(epoch, evidence)


def _evidence_digest(epoch: Epoch[RememberedDrive], evidence: Sequence[Evidence]) -> str:
    of_epoch = set(epoch.ids)
    lens = sorted([one.drive_id, one.digest, one.scale] for one in evidence if one.drive_id in of_epoch)
    told = [[one.drive_id, one.t_ns, one.information.tolist(), one.pull.tolist()] for one in _receivers(epoch, evidence)]
    return sha256_of_json([lens, told] if told else lens)


def _receivers(epoch: Epoch[RememberedDrive], evidence: Sequence[Evidence]) -> tuple[ReceiverEvidence, ...]:
    """What is told of the receiver until the epoch's newest drive: a knocked camera changes no clock."""
    until = epoch.drives[-1].t_ns
    told = [ReceiverEvidence.from_facts(one.drive_id, one.t_ns, one.receiver) for one in evidence if one.receiver is not None]
    return tuple(sorted((one for one in told if one.t_ns <= until), key=lambda one: (one.t_ns, one.drive_id)))


def _with_gnss(one: Evidence, said: ByGnss) -> Evidence:
    return replace(one, scale=said.scale or one.scale, receiver=said.receiver or one.receiver)


def _version(
    blobs: BlobStore, epoch: Epoch[RememberedDrive], evidence: Sequence[Evidence], newest: Mapping[int, str]
) -> NewRigVersion:
    """A version of an epoch's evidence; its file is in the blob store when this returns."""
    rig = replace(memory.learn_epoch(epoch), receivers=_receivers(epoch, evidence))
    assert rig.covariance is not None
    assert rig.bias_sigma_px is not None
    settings = with_bias_sigma(CalibrationSettings(), rig.bias_sigma_px)
    scale = scale_facts(epoch.drives[-1].observations(), rig.lens, rig.baseline_ratio, rig.covariance, settings) or {}
    facts = rig_facts(rig) | {"scale_sigma": scale.get("sigma"), "scale_sigma_of_lens": scale.get("lens_sigma")}
    facts |= {"receiver": receiver_facts(rig.receivers)}
    reason = _reason(epoch, rig, newest)
    log.info("rig learnt", rig_id=rig.rig_id, drives=len(epoch.drives), reason=reason)
    digest = blobs.put(text_of(rig).encode())
    return NewRigVersion(epoch.from_ns, _evidence_digest(epoch, evidence), digest, tuple(sorted(epoch.ids)), reason, facts)


def _reason(epoch: Epoch[RememberedDrive], rig: RigFile, newest: Mapping[int, str]) -> str:
    """Why there is a version. newest : digest of the evidence of each epoch's newest version so far"""
    if not newest:
        return "first drive"
    if rig.receivers and begins_epoch(rig.receivers, epoch.drives[-1].drive_id):
        return "the GNSS receiver was changed"
    begins = epoch.from_ns not in newest and epoch.chi_square is not None
    return "the rig was knocked" if begins and len(epoch.drives) == 1 else "evidence changed"


def _remembered(blobs: BlobStore, one: Evidence) -> RememberedDrive:
    scale = None if one.scale is None else ScaleByGnss.from_facts(one.scale)
    return RememberedDrive(one.drive_id, one.t_ns, _rig(blobs, one.own_digest), partial(_observations, blobs, one.digest), scale)


def _rig(blobs: BlobStore, digest: str) -> RigFile:
    return rig_from_text(blobs.get(digest).decode(), Path(f"{digest[:12]}.toml"))


def _observations(blobs: BlobStore, digest: str) -> Any:
    return observations_from_bytes(blobs.get(digest), Path(f"{digest[:12]}.npz"))


def _ensure(attempt: StageAttempt, drive_log: DriveLog) -> str | None:
    """The id of the drive's rig, whose row is there; None for a log that names none."""
    with attempt.context.database.write() as session:
        vehicle_id = drives.get(session, str(attempt.claim.drive_id)).vehicle_id or drive_log.vehicle_id
        if rigs.rig_key(vehicle_id, drive_log.rig_id) is None:
            return None
        return rigs.ensure(session, vehicle_id, drive_log.rig_id).id


def _recorded_ns(attempt: StageAttempt, drive_log: DriveLog) -> int:
    """When the drive was recorded, or, where the log's stamps are no dates, registered."""
    if (first := int(drive_log.t_ns[0])) > YEAR_2000_NS:
        return first
    with attempt.context.database.read() as session:
        return int(1e9 * drives.get(session, str(attempt.claim.drive_id)).created_at)


def _pinned(attempt: StageAttempt, drive_log: DriveLog) -> dict[str, Any] | None:
    """Which version the drive is tracked with: what was said first, so that a killed attempt goes on with the same one, unless it
    was learnt from a drive that was removed since."""
    key, drive_id, t_ns = _ensure(attempt, drive_log), str(attempt.claim.drive_id), _recorded_ns(attempt, drive_log)
    if key is None:
        return None
    with attempt.context.database.write() as session:
        said: dict[str, Any] | None = facts_of(drives.get(session, drive_id)).get("rig")
        if said is None or said["rig"] != key or (said["sha256"] and not rigs.has_file(session, key, said["sha256"])):
            said = _about(key, rigs.version_for(session, key, t_ns))
            rigs.use(session, drive_id, said)
        return said


def _about(key: str, version: Any) -> dict[str, Any]:
    number, digest = (None, None) if version is None else (version.version, version.digest)
    return {"rig": key, "version": number, "sha256": digest, "knocked": False}


def _check_version(attempt: StageAttempt, key: str) -> None:
    """Have the drive tracked again where the file that it was tracked with is of another epoch than its own evidence."""
    drive_id = str(attempt.claim.drive_id)
    with attempt.context.database.write() as session:
        said = facts_of(drives.get(session, drive_id)).get("rig") or {}
        own = rigs.evidence_of_drive(session, drive_id)
        if own is None or said.get("version") is None or said.get("knocked") or said.get("asked"):
            return
        same_epoch = {row.drive_id for row in rigs.evidence_of(session, key) if row.from_ns == own.from_ns}
        if same_epoch & set(rigs.version(session, key, said["version"]).drives):
            return
        right = rigs.version_for(session, key, own.t_ns)
        rigs.use(
            session, drive_id, {**_about(key, right), "knocked": True, "chi_square": own.chi_square, "instead_of": said["version"]}
        )
    log.warning("the rig was knocked before this drive", rig=key, chi_square=own.chi_square)
    raise RepeatStageError("the rig was knocked before this drive: it is tracked again with what its own images say")
