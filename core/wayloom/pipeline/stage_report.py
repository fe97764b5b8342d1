"""Report of a stage for people: times and statistics that no stage reads and no digest counts."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

REPORT_FILE: Final = "report.json"


def write_report(out_dir: Path, report: Mapping[str, Any]) -> None:
    """Write the JSON-able report into a stage's folder."""
    (out_dir / REPORT_FILE).write_text(json.dumps(report, indent=1) + "\n")
