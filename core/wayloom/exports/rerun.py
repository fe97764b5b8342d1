"""Rerun recording of results. The only import of rerun, which is an extra."""

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from wayloom.config.classes import PALETTE_WITH_VOID
from wayloom.config.extras import from_extra
from wayloom.errors import InputError
from wayloom.exports.recorded_drives import RecordedDrive, map_points, recorded_drives
from wayloom.exports.source import MapSource
from wayloom.geodesy.antimeridian import Box

TIMELINE = "time"


def write_rerun(path: Path, source: MapSource, box: Box | None, provenance: Mapping[str, Any]) -> int:
    """Write map points, ways, camera poses in time and label images; how many drives. Up is z, the cameras look along z.

    Raises MissingExtraError without rerun, InputError for a map that is not made of folders of drives, OSError.
    """
    with from_extra("rerun", "a recording for Rerun", path):
        import rerun as rr
    drives = recorded_drives(source, path)
    if not drives:
        raise InputError("there is no drive to play back", file=path, remedy="export folders of drives")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        unfinished = Path(folder) / path.name
        recording = rr.RecordingStream("wayloom")
        recording.save(str(unfinished))
        recording.log("map", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        recording.log("provenance", rr.TextDocument(json.dumps(provenance, indent=1)), static=True)
        points = map_points(source, box)
        colours = PALETTE_WITH_VOID[points.label]
        recording.log("map/points", rr.Points3D(points.points, colors=colours, class_ids=points.label, radii=0.06), static=True)
        for drive in drives:
            _log_drive(rr, recording, drive)
        recording.flush()
        recording.disconnect()
        unfinished.replace(path)
    return len(drives)


def _log_drive(rr: Any, recording: Any, drive: RecordedDrive) -> None:
    home = f"map/{drive.name}"
    recording.log(f"{home}/way", rr.LineStrips3D([drive.T_map_cam[:, :3, 3]]), static=True)
    for t_ns, T in zip(drive.t_ns.tolist(), drive.T_map_cam, strict=True):
        recording.set_time(TIMELINE, timestamp=1e-9 * t_ns)
        recording.log(f"{home}/left_camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    for frame, png in drive.pictures():
        recording.set_time(TIMELINE, timestamp=1e-9 * int(drive.t_ns[frame]))
        recording.log(f"{home}/labels", rr.EncodedImage(contents=png, media_type="image/png"))
