"""Provenance of a drive's finished stages: keys, digests, code, libraries, inputs and settings."""

import json
from typing import Any, Final

from wayloom.config.stages import drive_stages
from wayloom.pipeline.stage_files import read_stage_file
from wayloom.store import jobs
from wayloom.store.database import Session
from wayloom_workers.stage_hooks import StageAttempt

TOLD: Final = ("key", "digest", "code", "libraries", "inputs", "parameters")


def finished_stages(session: Session, attempt: StageAttempt) -> dict[str, Any]:
    """For each finished stage of the run that the attempt is of, what its stage.json says of how it was made."""
    drive_id = str(attempt.claim.drive_id)
    keys = jobs.keys_of_jobs(session, drive_id, drive_stages())
    stages = attempt.context.folders.drive(drive_id) / "stages"
    found = {stage: read_stage_file(stages / stage / key) or {"key": key} for stage, key in keys.items()}
    told = {stage: {name: content[name] for name in TOLD if name in content} for stage, content in found.items()}
    read: dict[str, Any] = json.loads(json.dumps(told), parse_constant=lambda _: None)  # no database has NaN
    return read
