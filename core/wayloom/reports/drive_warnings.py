"""Warnings about a drive's result in words: the same in the report of a folder and on the pages of a service."""

import math
from collections.abc import Mapping
from typing import Any, Final

DOUBTFUL_SCALE: Final = 0.02
"""Beyond it the odometry and the fixes contradict each other: stereo rigs are good to one per cent or so."""
BAD_CALIBRATION_PX: Final = 1.0
"""Rows or disparities that are further off are told of."""
CALIBRATION_FACTS: Final = ("rows_off_px", "disparity_bias_px", "self_calibration")
"""Of the odometry's report, what `calibration_warning` reads."""
FOREIGN_FIXES_M, FOREIGN_SCATTER = 3.0, 10.0
"""Fixes that lie so far off the drive's way in the plane, root mean square, and scatter so many times as much as their receiver
says, are hardly those of the drive."""
NETWORK_FACTS: Final = ("name", "grey_images_to_a_colour_network", "photographs_to_a_network_of_simulated_streets")
"""Of what the segmentation says of its network, what is read here."""
UNNEEDED: Final = ("IMU", "GNSS", "truth poses")
"""What a log may lack without a warning of its own: the geo-reference tells of missing GNSS, the rest costs little."""


def noted_warnings(facts: Mapping[str, Any]) -> list[str]:
    """The warnings by what the stages have noted, the most serious first; of a drive that is under way, those that are known.

    facts : what the stages noted: `odometry`, `georeference`, `log`, `network`, each of which may be missing
    """
    odometry, georeference, log, network = (facts.get(name) or {} for name in ("odometry", "georeference", "log", "network"))
    found = _lost_frames(odometry) if odometry else []
    found += _foreign_fixes(georeference) + _scale(georeference)
    found += [str(message) for message in georeference.get("messages", ())]
    off = calibration_warning(odometry)
    return found + ([] if off is None else [off]) + _of_log(log) + _of_network(network)


def calibration_warning(report: Mapping[str, Any]) -> str | None:
    """That the log's calibration is off, by how much, and what was done; None where it is not, or nobody has looked.

    report : the odometry's, or its CALIBRATION_FACTS
    """
    rows, bias, own = (
        report.get("rows_off_px", 0.0),
        abs(report.get("disparity_bias_px", 0.0)),
        report.get("self_calibration") or {},
    )
    if own.get("used"):
        return (
            f"the calibration is off: the right image by {own['moves_px']:.1f} px on average; the lens that the drive's own images "
            "tell of is used instead; `wayloom calibrate` learns it better from several drives"
        )
    if max(rows, bias) > BAD_CALIBRATION_PX:
        return (
            f"the calibration is off: rows of left and right by up to {rows:.1f} px, disparities by {bias:.1f} px; "
            "`wayloom calibrate` learns the rest of it from several drives"
        )
    return None


def _foreign_fixes(georeference: Mapping[str, Any]) -> list[str]:
    """That the way of the fixes is not that of the drive."""
    off_m = math.hypot(*(georeference.get("residual_rms_m") or (0.0,))[:2])
    scatter = max((georeference.get("scatter_ratio") or {}).values(), default=0.0)
    if off_m <= FOREIGN_FIXES_M or scatter <= FOREIGN_SCATTER:
        return []
    return [f"the fixes do not fit the drive: they lie {off_m:.1f} m off its way (root mean square); are they of this drive?"]


def _scale(georeference: Mapping[str, Any]) -> list[str]:
    """That odometry and fixes disagree on the length of the drive."""
    found = georeference.get("scale")
    if found is None or abs(found["mean"] - 1.0) <= DOUBTFUL_SCALE:
        return []
    return [
        f"odometry and GNSS disagree on the length of the drive by {100.0 * (found['mean'] - 1.0):+.1f} %: the rig's "
        "calibration or the fixes are wrong; the map follows the fixes from submap to submap, and the odometry within each"
    ]


def _of_network(network: Mapping[str, Any]) -> list[str]:
    """That the network was trained on other images than the drive's. network : its NETWORK_FACTS"""
    found = []
    if network.get("grey_images_to_a_colour_network"):
        found.append(f"the images are grey and the network {network['name']} was trained on colour: its labels are less certain")
    if network.get("photographs_to_a_network_of_simulated_streets"):
        found.append(
            f"the network {network['name']} knows simulated streets only: its labels of real ones are mostly wrong; give "
            "another by --model (`wayloom models` lists those that are known)"
        )
    return found


def _of_log(log: Mapping[str, Any]) -> list[str]:
    """What the log lacks. log : its facts, as `log.json` has them"""
    found = []
    lacking = [thing for thing in log.get("missing", ()) if thing not in UNNEEDED]
    if lacking:
        found.append(f"not in the log: {'; '.join(lacking)}")
    gaps = (log.get("frames") or {}).get("gaps", ())
    if gaps:
        worst = max(gap["seconds"] for gap in gaps)
        several = f"{len(gaps)} gaps in the frames' time stamps, the longest {worst:.2f} s"
        found.append(several if len(gaps) > 1 else f"a gap of {worst:.2f} s in the frames' time stamps")
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
