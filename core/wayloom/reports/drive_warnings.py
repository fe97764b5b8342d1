"""Warnings about a drive's result in words: the same in the report of a folder and on the pages of a service."""

from collections.abc import Mapping
from typing import Any, Final

DOUBTFUL_SCALE: Final = 0.02
"""Beyond it the odometry and the fixes contradict each other: stereo rigs are good to one per cent or so."""
UNNEEDED: Final = ("IMU", "GNSS", "truth poses")
"""What a log may lack without a warning of its own: the geo-reference tells of missing GNSS, the rest costs little."""


def noted_warnings(facts: Mapping[str, Any]) -> list[str]:
    """The warnings by what the stages have noted, the most serious first; of a drive that is under way, those that are known.

    facts : what the stages noted: `odometry`, `georeference`, `log`, each of which may be missing
    """
    odometry, georeference, log = (facts.get(name) or {} for name in ("odometry", "georeference", "log"))
    found = _lost_frames(odometry) if odometry else []
    found += _scale(georeference)
    found += [str(message) for message in georeference.get("messages", ())]
    return found + _of_log(log)


def _scale(georeference: Mapping[str, Any]) -> list[str]:
    """That odometry and fixes disagree on the length of the drive."""
    found = georeference.get("scale")
    if found is None or abs(found["mean"] - 1.0) <= DOUBTFUL_SCALE:
        return []
    return [
        f"odometry and GNSS disagree on the length of the drive by {100.0 * (found['mean'] - 1.0):+.1f} %: the rig's "
        "calibration or the fixes are wrong; the map follows the fixes"
    ]


def _of_log(log: Mapping[str, Any]) -> list[str]:
    """What the log lacks. log : its facts, as `log.json` has them"""
    found = []
    lacking = [thing for thing in log.get("missing", ()) if thing not in UNNEEDED]
    if lacking:
        found.append(f"not in the log: {'; '.join(lacking)}")
    gaps = (log.get("frames") or {}).get("gaps", ())
    if gaps:
        worst = max(gap["seconds"] for gap in gaps)
        found.append(f"{len(gaps)} gaps in the frames' time stamps, the longest {worst:.2f} s")
    return found


def _lost_frames(odometry: Mapping[str, Any]) -> list[str]:
    """That frames were lost: how many, why the first ones were, and whether the track goes on.

    odometry : `frames`, `frames_tracked`, `segments`, and `losses` with `frame` and `reason`
    """
    lost = odometry["frames"] - odometry["frames_tracked"]
    if lost <= 0:
        return []
    first = next(iter(odometry.get("losses", ())), None)
    why = f" (first frame {first['frame']}: {first['reason']})" if first else ""
    segments = odometry["segments"]
    joined = f"; the track has {segments} segments, joined by GNSS or by guesses" if segments > 1 else ""
    return [f"{lost} of {odometry['frames']} frames were lost{why} and hold a guess of constant motion{joined}"]
