"""A processed drive: all that is known of it when its stages are done."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from wayloom.georeference.types import GeoReference
from wayloom.labelling.types import PointLabels
from wayloom.logs.types import DriveLog
from wayloom.objects.types import MapObject
from wayloom.odometry.types import OdometryResult
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.submap import PlacedSubmap


@dataclass(frozen=True, slots=True)
class StageTime:
    """seconds that a stage took when it ran; reused is whether that was in an earlier run."""

    seconds: float
    reused: bool


@dataclass(frozen=True, slots=True)
class DriveResult:
    """All that is known of a processed drive.

    log_facts       content of ingest's log.json
    model           content of the segmentation's model.json
    odometry        its way, keyframes and calibration; of the points it is the labels, and the submaps, that tell
    observations    how often keyframes saw the odometry's points, their hosts left out
    images          the label images of the keyframes
    labels          of the odometry's points, without their votes
    submaps         read when they are asked for: those of a long drive do not lie in memory side by side
    quality         content of the geo-reference's quality.json
    objects         poles, signs, lights and trunks that the drive saw, each once, in the frame of `submaps`
    times           for each stage, in order
    """

    log: DriveLog
    log_facts: dict[str, Any]
    model: dict[str, Any]
    odometry: OdometryResult
    observations: int
    images: KeyframeLabels
    labels: PointLabels
    geo: GeoReference
    submaps: Sequence[PlacedSubmap]
    quality: dict[str, Any]
    objects: list[MapObject] = field(default_factory=list)
    times: dict[str, StageTime] = field(default_factory=dict)
