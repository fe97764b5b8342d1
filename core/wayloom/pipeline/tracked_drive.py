"""Tracked drive as the stages behind the odometry read it."""

from typing import Final

from wayloom.errors import TooFewKeyframesError
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, Wanted, load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.stage_context import StageContext

LEAST_KEYFRAMES: Final = 2


def tracked_drive(context: StageContext, wanted: Wanted = "all") -> OdometryResult:
    """The odometry stage's result, no more of it than a stage wants (`load_odometry`): several may have one in memory. Raises
    TooFewKeyframesError where nothing can be mapped."""
    result = load_odometry(context.inputs_dir / "odometry" / ODOMETRY_FILE, wanted)
    if len(result.keyframes) < LEAST_KEYFRAMES:
        raise TooFewKeyframesError(
            f"a map needs at least {LEAST_KEYFRAMES} keyframes, the odometry found {len(result.keyframes)} (frames in the log: "
            f"{len(result.trajectory)}); report.json in the odometry's folder says what was lost and why"
        )
    return result
