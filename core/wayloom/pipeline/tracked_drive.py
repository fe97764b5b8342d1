"""Tracked drive as the stages behind the odometry read it."""

from dataclasses import replace
from typing import Final

from wayloom.errors import TooFewKeyframesError
from wayloom.odometry.result.odometry_file import ODOMETRY_FILE, load_odometry
from wayloom.odometry.types import OdometryResult
from wayloom.pipeline.stage_context import StageContext

LEAST_KEYFRAMES: Final = 2


def without_observations(drive: OdometryResult) -> OdometryResult:
    """The drive for a stage that asks for none of its points' observations, so that they need not stay in memory."""
    return replace(drive, points=drive.points.without_observations())


def tracked_drive(context: StageContext) -> OdometryResult:
    """The odometry stage's result. Raises TooFewKeyframesError where nothing can be mapped."""
    result = load_odometry(context.inputs_dir / "odometry" / ODOMETRY_FILE)
    if len(result.keyframes) < LEAST_KEYFRAMES:
        raise TooFewKeyframesError(
            f"a map needs at least {LEAST_KEYFRAMES} keyframes, the odometry found {len(result.keyframes)} (frames in the log: "
            f"{len(result.trajectory)}); report.json in the odometry's folder says what was lost and why"
        )
    return result
