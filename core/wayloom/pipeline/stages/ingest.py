"""Ingest stage: every image decoded, every record looked at, and the parts of the log named by digests.

Leaves log.json: what `inspect_log` finds; the frames that cannot be used, which the drive then does without (`rejected`); and the
digest of each part of the log (`wayloom.pipeline.log_parts`).
"""

import hashlib
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

from wayloom.config.progress import Progress
from wayloom.logs.damage import told_again, without_frames
from wayloom.logs.inspection import inspect_log
from wayloom.logs.types import DriveLog
from wayloom.pipeline.log_parts import FORMAT_VERSION, LOG_FILE, LOG_PARTS, images_digest
from wayloom.pipeline.stage_context import StageContext


def run(context: StageContext, out_dir: Path, progress: Progress) -> None:
    """Raises LogError where more images are damaged than a drive can do without."""
    log = context.source.log
    threads = context.settings.threads
    digests: dict[Path, str] = {}

    def seen(file: Path, data: bytes) -> None:
        digests[file] = hashlib.sha256(data).hexdigest()

    report = inspect_log(log, progress=lambda share, what: progress(0.9 * share, what), threads=threads, seen=seen)
    rejected = {one.frame: one for one in reversed(report.damaged)}
    errors = {frame: told_again(one.problem, one.file, one.reason) for frame, one in rejected.items()}
    kept = without_frames(log, errors)
    parts: dict[str, Callable[[DriveLog, str], str]] = {**LOG_PARTS, "images": partial(images_digest, known=digests)}
    content = {
        "format_version": FORMAT_VERSION,
        "name": log.name,
        "rejected": {str(frame): one.model_dump(mode="json") for frame, one in sorted(rejected.items())},
        "digests": {part: digest(kept, context.reader_version) for part, digest in parts.items()},
        "log": report.model_copy(update={"missing": list(kept.missing)}).model_dump(mode="json"),
    }
    (out_dir / LOG_FILE).write_text(json.dumps(content, indent=1) + "\n")
    left_out = f", {len(rejected)} were left out" if rejected else ""
    progress(1.0, f"{len(kept)} frames are whole{left_out}")
