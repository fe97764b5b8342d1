"""What is kept of a run: how each of its stages was made."""

import json
from pathlib import Path

from sqlalchemy import select

from wayloom.config.progress import silent
from wayloom.pipeline.settings import WayloomSettings
from wayloom.store import drives, jobs
from wayloom.store.jobs import Claim
from wayloom.store.manifest import Manifest, ManifestFile
from wayloom.store.migrate import upgrade
from wayloom.store.tables.drives import Job
from wayloom_workers.__main__ import make_context
from wayloom_workers.finished_stages import finished_stages
from wayloom_workers.stage_hooks import StageAttempt


def test_every_finished_stage_tells_its_key_code_and_settings_and_one_whose_folder_is_gone_its_key(tmp_path: Path) -> None:
    context = make_context(WayloomSettings(data_dir=tmp_path / "data"))
    upgrade(context.database)
    said = {
        "stage": "odometry", "key": "k1", "digest": "d1", "seconds": 1.5, "code": "c1", "libraries": {"numpy": "2.4"},
        "inputs": {"log/images": "i1"}, "parameters": {"odometry": {"window": 7, "limit": float("nan")}},
    }  # fmt: skip
    with context.database.write() as session:
        manifest = Manifest(name="a", files=(ManifestFile(path="log/a", size=1, sha256="0" * 64),))
        drive_id = drives.register(session, manifest, "city")[0].id
        jobs.create_drive_jobs(session, drive_id)
        for stage, key in (("odometry", "k1"), ("labelling", "k2")):
            job = session.scalars(select(Job).where(Job.drive_id == drive_id, Job.stage == stage)).one()
            job.state, job.payload = "done", {"key": key}
    folder = context.folders.drive(drive_id) / "stages" / "odometry" / "k1"
    folder.mkdir(parents=True)
    (folder / "stage.json").write_text(json.dumps(said))
    claim = Claim(1, 1, "submaps", 1, drive_id, None, {})
    with context.database.read() as session:
        found = finished_stages(session, StageAttempt(context, claim, None, None, tmp_path, {}, tmp_path, silent))
    kept = {name: said[name] for name in ("key", "digest", "code", "libraries", "inputs")}
    assert found == {"odometry": kept | {"parameters": {"odometry": {"window": 7, "limit": None}}}, "labelling": {"key": "k2"}}
    context.database.close()
