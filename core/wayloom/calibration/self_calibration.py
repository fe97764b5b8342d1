"""Self-calibration of a drive whose rig has no file: the lens learnt from a few pieces of the drive before it is tracked.

A lens is used only where the observations contradict the ideal camera: x^T C^-1 x, x the ten parameters' differences and C their
covariance with everything in it that `learn` knows, is beyond what chance does to an ideal camera once in a thousand drives, and
where the lens moves pixels by so much that leaving it alone costs more than not knowing it well. So a rig that is calibrated well
loses nothing, to the bit. docs/calibration.md has the numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.covariance import chi_square
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.sampling import Sampler
from wayloom.calibration.settings import CalibrationSettings
from wayloom.config.progress import Progress, silent
from wayloom.geometry.lens import IDENTITY, RightLens, lens_from_values
from wayloom.logs.types import DriveLog
from wayloom.odometry import frame_source, warm_up
from wayloom.odometry.observers import Observer
from wayloom.odometry.odometry import track
from wayloom.odometry.rig import rows
from wayloom.odometry.rig.calibration_observations import CalibrationObservations, ObservationCollector
from wayloom.odometry.settings import OdometrySettings
from wayloom.odometry.types import OdometryResult

FloatArray = NDArray[np.float64]
GROUPS: Final = 15
"""Asked for; they are about 4 m apart."""
POINTS: Final = 160
"""Of a match group."""
LEAST_GROUPS: Final = 10
"""As many as the lens has parameters: from fewer, how much they contradict each other cannot be told."""
STRETCHES: Final = 3
"""Of the drive: turns and straights tell different parameters."""
LEAST_FRAMES, MOST_FRAMES = 30, 300
"""Of a stretch."""
CHI_SQUARE: Final = 29.588
"""Of ten degrees of freedom, exceeded once in a thousand."""
LEAST_RMS_PX: Final = 0.2
"""0.5 px cost 0.5 to 0.7 % of the way, and what so few matches do not know of the lens 0.05 to 0.3 %; perfect rigs seem to have
0.01 to 0.05 px, in hard light up to 0.15."""
SMALLEST_STEP: Final = 0.05
"""sigmas, of the last iteration; each is about 0.7 of the one before, so a tenth of a sigma is left at most."""
BIAS_SIGMA_PX: Final = 0.025
"""Of the disparity bias beside a lens of the drive's own, whose shift of the columns holds the bias already: about what such a lens
is off by."""
STEP: Final = 1e-7
"""Parameters are whole multiples of it, so that the last bits of a linear algebra library do not decide about a drive's."""


@dataclass(frozen=True, slots=True)
class SelfCalibration:
    """What the drive says: the lens to use (ideal where nothing speaks against it), and why.

    reason : in words
    rms_px : how far the learnt lens moves pixels, the mean shift of the columns taken off; NaN where none was learnt
    """

    lens: RightLens
    reason: str
    groups: int
    chi_square: float
    rms_px: float


@dataclass(frozen=True, slots=True)
class DriveCalibration:
    """What the whole drive is tracked with, whether as one piece or in parts.

    lens        of the right camera
    matches     (n, 4) of the first pairs (`frame_source.first_matches`), which the rows are fitted to; None: not yet looked for
    bias_prior  of the settings, for this lens
    report      JSON-ready, what goes into the odometry's report
    seconds     that it took to learn the lens
    """

    lens: RightLens
    matches: FloatArray | None
    bias_prior: float
    report: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0

    def settings(self, settings: OdometrySettings) -> OdometrySettings:
        """Those that the drive is tracked with."""
        return settings.model_copy(update={"bias_prior": self.bias_prior})

    def complete(self, result: OdometryResult) -> OdometryResult:
        """The result, its report with what was learnt before."""
        result.report.update(self.report)
        if self.report:
            result.report["seconds"]["own lens"] = round(self.seconds, 4)
        return result


def track_calibrated(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens | None = None, observers: Sequence[Observer] = (), matches: FloatArray | None = None,
) -> OdometryResult:  # fmt: skip
    """As `wayloom.odometry.odometry.track`; without a lens (of a rig's file) the drive's own is learnt first, and told in the
    report. matches : of the first pairs, as of `frame_source.first_matches`, where the caller has them."""
    known = calibrate_drive(log, settings, progress, lens, matches)
    result = track(log, known.settings(settings), progress, threads, known.lens, observers, known.matches)
    return known.complete(result)


def calibrate_drive(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, lens: RightLens | None = None,
    matches: FloatArray | None = None,
) -> DriveCalibration:  # fmt: skip
    """The lens that is known, or else the drive's own, where the settings want it. Arguments as of `track_calibrated`."""
    if lens is not None or not settings.self_calibration:
        return DriveCalibration(IDENTITY if lens is None else lens, matches, settings.bias_prior)
    frame_source.check_rig(log)
    warm_up.compile_odometry(False, progress)
    start = process_time()
    progress(0.0, "learning the right camera's lens from pieces of the drive")
    if matches is None:
        with frame_source.one_opencv_thread():
            matches = frame_source.first_matches(log, settings.row_frames)
    own = self_calibrated_lens(log, settings, matches)
    seconds, bias_prior = process_time() - start, settings.bias_prior
    if not own.lens.is_ideal:
        bias_prior = max(bias_prior, (settings.grey_sigma / BIAS_SIGMA_PX) ** 2)
    facts = {
        "used": not own.lens.is_ideal, "why": own.reason, "match_groups": own.groups,
        "chi_square": None if np.isnan(own.chi_square) else round(own.chi_square, 1),
        "moves_px": None if np.isnan(own.rms_px) else round(own.rms_px, 3),
    }  # fmt: skip
    return DriveCalibration(own.lens, matches, bias_prior, {"self_calibration": facts}, seconds)


def self_calibrated_lens(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), matches: FloatArray | None = None
) -> SelfCalibration:
    """The lens that a drive tells of. matches : as of `track`. Raises as it does."""
    with frame_source.one_opencv_thread():
        observations = sampled_observations(log, settings, matches)
    if observations.groups < LEAST_GROUPS:
        reason = f"{observations.groups} groups of matches are too few to tell a lens by"
        return SelfCalibration(IDENTITY, reason, observations.groups, float("nan"), float("nan"))
    learning = CalibrationSettings(smallest_step=SMALLEST_STEP)
    learnt = learn_rig([observations], learning)
    against = chi_square(learnt.rig, learning)
    lens, reason = IDENTITY, ""
    if not learnt.converged:
        reason = "the matches did not settle on a lens"
    elif not against > CHI_SQUARE:
        reason = "nothing speaks against the log's calibration"
    elif not learnt.rms_px > LEAST_RMS_PX:
        reason = f"the lens is too small to be worth its own uncertainty ({LEAST_RMS_PX:g} px)"
    else:
        reason = "the drive's own images contradict the log's calibration"
        lens = lens_from_values(np.round(learnt.rig.lens.values / STEP) * STEP)
    return SelfCalibration(lens, reason, observations.groups, against, learnt.rms_px)


def sampled_observations(log: DriveLog, settings: OdometrySettings, matches: FloatArray | None = None) -> CalibrationObservations:
    """GROUPS match groups or fewer from STRETCHES parts of a drive."""
    right_rectifier = rows.RightRectifier(log.rig, IDENTITY, frame_source.fit_rows(log, settings.row_frames, matches=matches))
    collector, count = ObservationCollector(log.rig, POINTS), max(1, min(STRETCHES, len(log) // LEAST_FRAMES))
    sampler, starts = Sampler(log, settings, right_rectifier, collector), [k * len(log) // count for k in range(count + 1)]
    for k, start in enumerate(starts[:-1]):
        sampler.stretch(start, min(starts[k + 1], start + MOST_FRAMES), GROUPS * (k + 1) // count)
    return collector.observations(log)
