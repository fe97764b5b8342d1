"""Origin of one drive's outputs, as the files of its stages tell it."""

import json
from pathlib import Path
from typing import Any, Final

from wayloom.config.stages import origins_of

REPORT_FILE: Final = "report.json"
"""Of a drive's outputs."""
LOG_PARTS: Final = ("images", "gnss", "imu", "exposure")


def drive_origin(stages: Path, drive_id: str, of: str | None = None) -> dict[str, Any]:
    """Hashes of the recording's parts, the network, and the code of each stage; of a bare folder of submaps the drive's id alone.

    stages : the folder `stages` that `wayloom process` wrote
    of     : the stage whose result is told of: the code is that of the stages that it comes of, whether others are done or not
    """
    log, model = _content(stages / "ingest" / "log.json"), _content(stages / "segmentation" / "model.json")
    found: dict[str, Any] = {"id": drive_id}
    if log is not None:
        digests = log.get("digests", {})
        found["sha256"] = {name: digests[name] for name in LOG_PARTS if name in digests}
        about = log.get("log", {})
        found |= {name: about[name] for name in ("format", "start", "rig_id", "vehicle_id") if about.get(name)}
    if model is not None:
        found["network"] = {name: model[name] for name in ("name", "sha256", "licence") if name in model}
    told = {one.parent.name: _content(one) for one in sorted(stages.glob("*/stage.json"))}
    if of is not None:
        told = {name: content for name, content in told.items() if name in origins_of(of)}
    code = {name: content["code"] for name, content in told.items() if content is not None and "code" in content}
    return found | ({"code": code} if code else {})


def _content(file: Path) -> dict[str, Any] | None:
    """A JSON object; None where the file is none: provenance is no reason to fail."""
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None
