"""A drive that is removed leaves nothing of itself in any file and any row."""

import json
from typing import Any

from sqlalchemy import select

from service_kit.packed_drives import packed_drive_of
from wayloom.config.roles import Role
from wayloom.store import drives, gate, maps, meetings, rigs, runs
from wayloom.store.access import audit, keys
from wayloom.store.access.audit import Noted
from wayloom.store.erasure import NOBODY, unnamed
from wayloom.store.jobs import new_job
from wayloom.store.rigs import Evidence, EvidenceEpoch, NewRigVersion
from wayloom.store.tables.access import AccessKey, AuditEntry
from wayloom.store.tables.base import Base
from wayloom.store.tables.drives import Drive, Job, Vehicle
from wayloom.store.tables.maps import ForgottenBlob, MapVersion, MeetingRow
from wayloom.store.tables.rigs import Rig, RigVersion
from wayloom_workers.broker import make_app
from wayloom_workers.production import stage_hooks
from wayloom_workers.removal import remove_files
from wayloom_workers.runner import run_job
from wayloom_workers.stage_hooks import PreparedStage, StageAttempt, StageHooks, WorkerContext
from wayloom_workers.submap_rows import submap_row
from wayloom_workers.sweeper import sweep_once
from workers.test_stitching import placed, publish_next, requested, run

VEHICLE, DRIVE_NAME, IMAGE = "canary-van-7719", "canary street at dawn", b"canary pixels \x00\x01\x02 of a street"
STAYS = {"audit_log": ("object",), "access_keys": ("name", "vehicle_id")}
"""Columns that keep the id of a drive and the name of its vehicle, as docs/privacy.md says."""


def stay(context: WorkerContext) -> str:
    """Another drive of the same street and another vehicle."""
    return in_map(context, drives_manifest(context, "stays", "van-1", b"others"), 1)


def drives_manifest(context: WorkerContext, name: str, vehicle: str, image: bytes) -> Any:
    """The manifest of a drive whose files lie in its folder."""
    folder = context.folders.root.parent / name.replace(" ", "-")
    folder.mkdir()
    packed = packed_drive_of(folder, name, {"log/image_0/000000.png": image})
    manifest = packed.manifest.model_copy(update={"vehicle_id": vehicle})
    file = context.folders.drive(manifest.drive_id) / "log" / "image_0" / "000000.png"
    file.parent.mkdir(parents=True)
    file.write_bytes(image)
    return manifest


def in_map(context: WorkerContext, manifest: Any, seed: int) -> str:
    """The drive, processed and in the newest version, with all that is written of one."""
    with context.database.write() as session:
        drive_id = drives.register(session, manifest, "city")[0].id
        drives.mark_complete(session, drive_id, "log/image_0/000000.png")
        for job in session.scalars(select(Job).where(Job.drive_id == drive_id)):
            job.state, job.payload = "done", {"key": "1" * 64}
        item = placed(drive_id, seed)
        context.blobs.put(item.submap.encoded)
        maps.place_submaps(session, drive_id, [submap_row(drive_id, "city", 0, item)])
        drive = drives.get(session, drive_id)
        runs.record(session, drive, {"odometry": {"key": drive_id}}, [item.submap.digest])
        drive.facts = {name: context.blobs.put(f"{name} of {manifest.name}".encode()) for name in ("preview", "quality")}
        gate.judge(session, drive_id, "A", [], "merge")
        gate.ask_map(session, drive)
        learn(context, session, drive_id, manifest.vehicle_id)
    publish_next(context)
    return drive_id


def learn(context: WorkerContext, session: Any, drive_id: str, vehicle: str) -> None:
    """The rig's first version, from this drive."""
    rig = rigs.ensure(session, vehicle, "stereo")
    said = [context.blobs.put(f"{what} of {drive_id}".encode()) for what in ("evidence", "own", "rig file")]
    new = NewRigVersion(1, "2" * 64, said[2], (drive_id,), "first drive", {"receiver": [drive_id]})
    evidence = Evidence(drive_id, said[0], said[1], 1)
    assert rigs.write(session, rig.id, rig.revision, {drive_id: EvidenceEpoch(1, None, False)}, [new], [evidence])
    drive = drives.get(session, drive_id)
    drive.facts = {**drive.facts, "rig": {"rig": rig.id, "version": 1, "sha256": said[2]}}


def words_of_others(context: WorkerContext, goes: str, stays: str) -> None:
    """What other rows and folders may say of a drive."""
    with context.database.write() as session:
        blob = context.blobs.put(f"what {goes} and {stays} have in common".encode())
        a, b = sorted([goes, stays])
        meetings.keep(session, [MeetingRow(map_id="city", drive_a=a, drive_b=b, inputs="1" * 64, digest=blob, count=1)])
        verdict = {"admitted": False, "reason": f"meets {goes[:12]}", "drives": [stays, goes]}
        drives.get(session, stays).map_verdict = verdict
        session.add(new_job("stitch", 0.0, state="done", map_id="city", position=0, error=f"drive {goes[:12]} was in the way"))
        first = session.get_one(MapVersion, ("city", 1))
        first.facts = {"aligned": {"guests": {goes: 1, stays: 2}}, "out_of_reach": [goes]}
    for name in ("stages/odometry/key/odometry.npz", "stages/places/key/drive.places", "parts/odometry/1/part", "attempts/a/b"):
        file = context.folders.drive(goes) / name
        file.parent.mkdir(parents=True)
        file.write_bytes(IMAGE)
    context.folders.trash.mkdir()
    (context.folders.trash / "left").mkdir()
    (context.folders.trash / "left" / "000000.png").write_bytes(IMAGE)
    context.folders.uploads.mkdir(exist_ok=True)
    (context.folders.uploads / f"{'a' * 32}.part").write_bytes(IMAGE)


def asked_for(context: WorkerContext, goes: str) -> None:
    """The vehicle's key, and the audit log's entry of the drive that it has announced."""
    with context.database.write() as session:
        key, _ = keys.create(session, VEHICLE, Role.VEHICLE, VEHICLE)
        audit.append(session, [Noted(0.0, f"key {key.prefix}", "vehicle", "POST /v1/drives", goes, "10.0.0.1", 201, "done")])


def remove(context: WorkerContext, drive_id: str) -> None:
    """As `DELETE` does, and all that follows from it."""
    with context.database.write() as session:
        removal = drives.request_removal(session, drive_id)
    run_job(context, _hooks, lambda _: None, removal.job_id)
    with context.database.read() as session:
        assert session.get(Drive, drive_id) is None
    (publishing,) = run(context, requested(context))
    run(context, publishing.job_id)


def _hooks(stage: str) -> StageHooks:
    """Those of the service; the evidence of these drives cannot be learnt from."""
    hooks = stage_hooks(stage)
    if stage != "remove":
        return hooks
    return StageHooks(hooks.prepare, remove_files, hooks.record)


def kept_values(context: WorkerContext) -> list[bytes]:
    """What stands in the columns that stay."""
    with context.database.read() as session:
        tables = [(table, STAYS[table.name]) for table in Base.metadata.sorted_tables if table.name in STAYS]
        rows = [row for table, names in tables for row in session.execute(select(*(table.columns[name] for name in names)))]
    return [str(value).encode() for row in rows for value in row]


def traces(context: WorkerContext, *words: str | bytes) -> list[str]:
    """Files and rows that hold any of these, in whatever column or place, but for what stays as often as it does."""
    wanted = [word.encode() if isinstance(word, str) else word for word in words]
    stays = kept_values(context)
    found = []
    for path in context.folders.root.rglob("*"):
        content = path.read_bytes() if path.is_file() else b""
        for value in stays if path.suffix == ".db" else ():
            content = content.replace(value, b"", 1)
        found += [str(path)] if path.is_file() and any(word in str(path).encode() or word in content for word in wanted) else []
    with context.database.read() as session:
        for table in Base.metadata.sorted_tables:
            looked_at = [column for column in table.columns if column.name not in STAYS.get(table.name, ())]
            for row in session.execute(select(*looked_at)):
                text = json.dumps([str(value) for value in row], ensure_ascii=False).encode()
                found += [f"{table.name}: {text!r}" for word in wanted if word in text]
    return found


def test_after_a_drive_is_removed_no_file_and_no_row_tells_of_it(context: WorkerContext) -> None:
    stays = stay(context)
    manifest = drives_manifest(context, DRIVE_NAME, VEHICLE, IMAGE)
    goes = in_map(context, manifest, 2)
    words_of_others(context, goes, stays)
    asked_for(context, goes)
    with context.database.read() as session:
        hashes = [row.digest for row in maps.submaps_of(session, goes)] + [manifest.files[0].sha256]
    canaries = (goes, goes[:12], VEHICLE, DRIVE_NAME, IMAGE, *hashes)
    assert len(traces(context, *canaries)) > 20
    remove(context, goes)
    sweep_once(context, make_app(context.settings))
    assert traces(context, *canaries) == []
    with context.database.read() as session:
        assert session.scalars(select(ForgottenBlob)).all() == []
        assert session.scalars(select(AuditEntry.object)).all() == [goes]
        assert session.execute(select(AccessKey.name, AccessKey.vehicle_id)).all() == [(VEHICLE, VEHICLE)]
        assert [row.id for row in session.scalars(select(Vehicle))] == ["van-1"]
        assert [row.vehicle_id for row in session.scalars(select(Rig))] == ["van-1"]
        assert [row.drives for row in session.scalars(select(RigVersion))] == [[stays]]
        assert session.get_one(MapVersion, ("city", 1)).facts == {"aligned": {"guests": {stays: 2}}, "out_of_reach": []}
        assert drives.get(session, stays).map_verdict == {"admitted": False, "reason": f"meets {NOBODY}", "drives": [stays]}
        assert [row.version for row in maps.versions(session, "city")] == [3, 1]


def test_what_a_worker_stores_while_its_drive_is_removed_goes_with_the_next_look_of_the_sweeper(context: WorkerContext) -> None:
    manifest = drives_manifest(context, DRIVE_NAME, VEHICLE, IMAGE)
    with context.database.write() as session:
        drive_id = drives.register(session, manifest, "city")[0].id
        first = drives.mark_complete(session, drive_id, "log/image_0/000000.png")
    assert first is not None
    kept = context.blobs.put(b"somebody else's")

    def share(attempt: StageAttempt) -> None:
        attempt.context.blobs.put(IMAGE)
        with context.database.write() as session:
            drives.request_removal(session, drive_id)

    hooks = StageHooks(lambda attempt: PreparedStage("1" * 64, lambda: None), share)
    assert run_job(context, lambda _: hooks, lambda _: None, first.job_id)
    assert len([*context.blobs.older_than(0.0)]) == 2
    with context.database.read() as session:
        removal = session.scalars(select(Job).where(Job.drive_id == drive_id)).one()
    run_job(context, _hooks, lambda _: None, removal.id)
    sweep_once(context, make_app(context.settings))
    assert [*context.blobs.older_than(0.0)] == [kept]
    assert traces(context, drive_id, VEHICLE, DRIVE_NAME, IMAGE) == []


def test_what_does_not_name_the_drive_is_left_as_it_is() -> None:
    content = {"a": [1, "b" * 64], "c": None}
    assert unnamed(content, "a" * 64) is content
    named = {"a": ["a" * 64, {"drive": "a" * 64, "n": 1}, ["x", "a" * 64], f"by {'a' * 12}"], "a" * 64: 3}
    assert unnamed(named, "a" * 64) == {"a": [f"by {NOBODY}"]}
