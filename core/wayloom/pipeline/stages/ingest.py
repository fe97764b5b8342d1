"""Ingest stage: every image decoded, every record looked at, and the parts of the log named by digests.

Leaves log.json: what `inspect_log` finds, and the digest of each part of the log (`wayloom.pipeline.log_parts`).
"""

import json
from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.errors import LogError
from wayloom.logs.inspection import inspect_log
from wayloom.pipeline.log_parts import FORMAT_VERSION, LOG_FILE, LOG_PARTS
from wayloom.pipeline.stage_context import StageContext


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises LogError for damaged images."""
    log = context.log
    report = inspect_log(log, decode=True, progress=lambda share, what: progress(0.9 * share, what))
    if report.damaged:
        what = f"{len(report.damaged)} of {2 * len(log)} images cannot be used; the first: {report.damaged[0].problem}"
        raise LogError(what)
    content = {
        "format_version": FORMAT_VERSION,
        "name": log.name,
        "digests": {part: digest(log, context.reader_version) for part, digest in LOG_PARTS.items()},
        "log": report.model_dump(mode="json"),
    }
    (out_dir / LOG_FILE).write_text(json.dumps(content, indent=1) + "\n")
    progress(1.0, f"{len(log)} frames are whole")
