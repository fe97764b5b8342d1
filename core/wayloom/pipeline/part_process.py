"""Program that tracks one part of a drive: a request on stdin, the share that is done on stdout, the part in its place.

`wayloom.pipeline.part_processes` starts it.
"""

import json
import sys
from pathlib import Path

from wayloom.pipeline.log_source import LogSource
from wayloom.pipeline.odometry_parts import parts_of, track_part_at_home
from wayloom.pipeline.settings import ProcessSettings
from wayloom.pipeline.stage_context import StageContext


def main() -> None:
    """Raises what tracking the part does."""
    request = json.load(sys.stdin)
    gnss = None if request["gnss"] is None else Path(request["gnss"])
    settings = ProcessSettings.model_validate(request["settings"])
    context = StageContext(LogSource(Path(request["log"]), gnss), Path(request["inputs_dir"]), settings)
    track_part_at_home(context, parts_of(context)[request["part"]], Path(request["parts_dir"]), _tell)


def _tell(share: float, _: str, /) -> None:
    sys.stdout.write(f"{share:.4f}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
