"""The lens of a rig of which no file is known, from the first stretch of the drive itself.

What a lens does to the columns of the right image lengthens and bends a drive by half a percent and more, from its first metre on.
So a short first stretch is tracked once to gather evidence, the lens is learnt from it as `wayloom calibrate` does from many
drives, and the drive begins anew with it. A lens so small that a perfect rig could seem to have it is not used.
"""

from typing import Final

from wayloom.calibration.learn import learn_rig
from wayloom.config.progress import Progress, silent
from wayloom.errors import CalibrationError
from wayloom.geometry.lens import IDENTITY, RightLens
from wayloom.logs.types import DriveLog
from wayloom.odometry import feed
from wayloom.odometry.debug import Debug
from wayloom.odometry.evidence import Evidence, EvidenceCollector
from wayloom.odometry.odometry import Odometry, track
from wayloom.odometry.rows import RightImages
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult
from wayloom.odometry.visual_inertial import for_log

SNIPPETS: Final = 16
"""Groups of matches, one every two metres, after which the stretch ends."""
MOST_FRAMES: Final = 300
LEAST_RMS_PX: Final = 0.2
"""A lens that moves pixels by less on average, its mean shift of the columns taken off, is not believed: a perfect rig seems to
have 0.01 to 0.03 px, in hard light up to 0.12."""


def track_calibrated(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens = IDENTITY, collector: EvidenceCollector | None = None, debug: Debug | None = None,
) -> OdometryResult:  # fmt: skip
    """As `wayloom.odometry.odometry.track`, with the drive's own lens where none is known."""
    if lens.is_ideal and settings.learn_lens:
        lens = own_lens(log, settings, lambda share, what: progress(0.0, what))
    return track(log, settings, progress, threads, lens, collector, debug)


def own_lens(log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent) -> RightLens:
    """The lens that the first stretch of a drive shows; the ideal one where it is too short, stands, or shows none. What it leaves
    undetermined stays near the ideal camera.

    Raises LogError and CalibrationError as `track` does.
    """
    evidence = first_evidence(log, settings, progress)
    try:
        learnt = learn_rig([evidence])
    except CalibrationError:  # too few matches
        return IDENTITY
    return learnt.rig.lens if learnt.rms_px >= LEAST_RMS_PX else IDENTITY


def first_evidence(log: DriveLog, settings: OdometrySettings, progress: Progress = silent) -> Evidence:
    """What the first stretch tells of the rig."""
    collector = EvidenceCollector(log.rig)
    frames = min(len(log), MOST_FRAMES)
    with feed.one_opencv_thread():
        right_images = RightImages(log.rig, IDENTITY, feed.fit_rows(log, settings.row_frames))
        odometry = Odometry(right_images, settings, for_log(log, settings), collector)
        for frame in feed.frames(log, 1, odometry.stopwatch, odometry.levels):
            odometry.process(frame)
            progress(frame.index / frames, "learning the right camera's lens from the first stretch")
            if len(collector.finished) >= SNIPPETS or frame.index >= frames - 1:
                break
    return collector.evidence(log)
