"""Context of a stage: the log, the finished stages before it, and the settings.

Every room imports this module, so it imports no room: what only some stages read has a module of its own.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from wayloom.logs.types import DriveLog
    from wayloom.pipeline.labels_ahead import LabelsAhead
    from wayloom.pipeline.log_source import LogSource
    from wayloom.pipeline.settings import ProcessSettings
    from wayloom.segmentation.network import Network


@dataclass(frozen=True, slots=True)
class StageContext:
    """What the stages of one drive are given.

    source         the drive's log, opened once, when the first stage asks for it
    inputs_dir     the folders of finished stages lie (or are linked) there under their stages' names
    drive_id       the name that the map shall keep for the drive; None takes the log's
    parts_dir      where a stage that works in parts keeps those that are finished, of its key; None: nowhere beyond its run
    ahead          is told of keyframes by the odometry and labels them meanwhile; None: nobody does
    network        the settings' network, where the caller has opened it
    first_matches  (n, 4) stereo matches of the first pairs (`odometry.frame_source.first_matches`) where the caller has them
    """

    source: "LogSource"
    inputs_dir: Path
    settings: "ProcessSettings"
    drive_id: str | None = None
    first_matches: NDArray[np.float64] | None = None
    parts_dir: Path | None = None
    ahead: "LabelsAhead | None" = None
    network: "Network | None" = None

    @property
    def log(self) -> "DriveLog":
        """The drive log, without the frames that `ingest` left out. Raises LogError, CalibrationError or UnknownFormatError."""
        return self.source.log_after(self.inputs_dir / "ingest")

    @property
    def reader_version(self) -> str:
        """The version of the code that reads logs of this format."""
        return self.source.reader_version
