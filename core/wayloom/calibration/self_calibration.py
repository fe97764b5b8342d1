"""Self-calibration of a drive whose rig has no file: the lens learnt from a few pieces of the drive before it is tracked.

A lens is used only where the observations contradict the ideal camera: x^T C^-1 x, x the ten parameters' differences and C their
covariance with everything in it that `learn` knows, is beyond what chance does to an ideal camera once in a thousand drives, and
where the lens moves pixels by so much that leaving it alone costs more than not knowing it well. So a rig that is calibrated well
loses nothing, to the bit. docs/calibration.md has the numbers.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import process_time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.baseline import joint_covariance
from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.rig_file import RigFile
from wayloom.calibration.sampling import Sampler
from wayloom.calibration.scale import scale_facts
from wayloom.calibration.settings import CalibrationSettings, DrivePrior, with_bias_sigma
from wayloom.config.progress import Progress, silent
from wayloom.config.side_by_side import in_order
from wayloom.geometry.lens import IDENTITY, RightLens, lens_from_values
from wayloom.logs.types import DriveLog
from wayloom.odometry import frame_source, warm_up
from wayloom.odometry.held_images import held_images, release
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
    covariance : (10, 10) of what is known of the lens, whether it is used or not
    """

    lens: RightLens
    reason: str
    groups: int
    chi_square: float
    rms_px: float
    covariance: FloatArray


@dataclass(frozen=True, slots=True)
class DriveCalibration:
    """What the whole drive is tracked with, whether as one piece or in parts.

    lens        of the right camera
    matches     (n, 4) of the first pairs (`frame_source.first_matches`), which the rows are fitted to; None: not yet looked for
    bias_prior  of the settings, for this lens
    report      JSON-ready, what goes into the odometry's report
    seconds     that it took to learn the lens
    baseline_ratio  true baseline over that of the log
    covariance  (11, 11) of lens and log baseline ratio; None where nobody asked
    bias_sigma_px   with which that covariance was learnt, of the drive's own disparity bias
    """

    lens: RightLens
    matches: FloatArray | None
    bias_prior: float
    report: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0
    baseline_ratio: float = 1.0
    covariance: FloatArray | None = None
    bias_sigma_px: float = DrivePrior().disparity_bias_px

    def settings(self, settings: OdometrySettings) -> OdometrySettings:
        """Those that the drive is tracked with."""
        return settings.model_copy(update={"bias_prior": self.bias_prior})

    def complete(self, result: OdometryResult, observations: CalibrationObservations | None = None) -> OdometryResult:
        """The result, its report with what was learnt before, and with the sigma of its scale (`scale.scale_facts`) where the
        drive's observations are given."""
        result.report.update(self.report)
        if "self_calibration" in self.report:
            result.report["seconds"]["own lens"] = round(self.seconds, 4)
        if observations is not None and observations.groups and self.covariance is not None:
            learning = with_bias_sigma(CalibrationSettings(), self.bias_sigma_px)
            result.report["scale"] = scale_facts(observations, self.lens, self.baseline_ratio, self.covariance, learning)
        return result


def track_calibrated(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens | None = None, observers: Sequence[Observer] = (), matches: FloatArray | None = None,
    rig: RigFile | None = None,
) -> OdometryResult:  # fmt: skip
    """As `wayloom.odometry.odometry.track`; without a rig's file or a lens the drive's own is learnt first, and told in the
    report. matches : of the first pairs, as of `frame_source.first_matches`, where the caller has them."""
    log = held_images(log)
    known = calibrate_drive(log, settings, progress, lens, matches, rig, threads)
    release(log)
    result = track(log, known.settings(settings), progress, threads, known.lens, observers, known.matches, known.baseline_ratio)
    return known.complete(result)


def calibrate_drive(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, lens: RightLens | None = None,
    matches: FloatArray | None = None, rig: RigFile | None = None, threads: int = 1,
) -> DriveCalibration:  # fmt: skip
    """What is known of the rig, or else the drive's own lens, where the settings want it. Arguments as of `track_calibrated`."""
    if rig is not None:
        return _known_rig(rig, settings, matches)
    if lens is not None or not settings.self_calibration:
        return DriveCalibration(IDENTITY if lens is None else lens, matches, settings.bias_prior)
    frame_source.check_rig(log)
    warm_up.compile_odometry(False, progress)
    start = process_time()
    progress(0.0, "learning the right camera's lens from pieces of the drive")
    if matches is None:
        with frame_source.one_opencv_thread():
            matches = frame_source.first_matches(log, settings.row_frames)
    own = self_calibrated_lens(log, settings, matches, threads)
    seconds, bias_prior = process_time() - start, settings.bias_prior
    if not own.lens.is_ideal:
        bias_prior = max(bias_prior, _bias_information(settings, BIAS_SIGMA_PX))
    facts = {
        "used": not own.lens.is_ideal, "why": own.reason, "match_groups": own.groups,
        "chi_square": None if np.isnan(own.chi_square) else round(own.chi_square, 1),
        "moves_px": None if np.isnan(own.rms_px) else round(own.rms_px, 3),
    }  # fmt: skip
    covariance = joint_covariance(own.covariance, CalibrationSettings().baseline_sigma)
    return DriveCalibration(own.lens, matches, bias_prior, {"self_calibration": facts}, seconds, covariance=covariance)


def _known_rig(rig: RigFile, settings: OdometrySettings, matches: FloatArray | None) -> DriveCalibration:
    """What a rig's file says; one of `wayloom calibrate` leaves the baseline and each drive's bias as uncertain as they are."""
    learning, bias_prior = CalibrationSettings(), settings.bias_prior
    covariance, bias_sigma_px = rig.covariance, learning.drive.disparity_bias_px
    if covariance is None:
        covariance = joint_covariance(lens_covariance(rig, learning)[0], learning.baseline_sigma)
    if rig.bias_sigma_px is not None:
        bias_sigma_px = rig.bias_sigma_px
        bias_prior = max(bias_prior, _bias_information(settings, bias_sigma_px))
    return DriveCalibration(
        rig.lens, matches, bias_prior, baseline_ratio=rig.baseline_ratio, covariance=covariance, bias_sigma_px=bias_sigma_px
    )


def _bias_information(settings: OdometrySettings, sigma_px: float) -> float:
    """Of a disparity bias that is known about zero to sigma_px, as the odometry's settings want it."""
    return (settings.grey_sigma / sigma_px) ** 2


def self_calibrated_lens(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), matches: FloatArray | None = None, threads: int = 1
) -> SelfCalibration:
    """The lens that a drive tells of. matches : as of `track`. Raises as it does."""
    with frame_source.one_opencv_thread():
        observations = sampled_observations(log, settings, matches, threads)
    if observations.groups < LEAST_GROUPS:
        reason = f"{observations.groups} groups of matches are too few to tell a lens by"
        unknown = np.diag(CalibrationSettings().lens.sigmas ** 2)
        return SelfCalibration(IDENTITY, reason, observations.groups, float("nan"), float("nan"), unknown)
    learning = CalibrationSettings(smallest_step=SMALLEST_STEP)
    learnt = learn_rig([observations], learning)
    covariance, x = lens_covariance(learnt.rig, learning)[0], learnt.rig.lens.values - RightLens().values
    against = float(x @ np.linalg.solve(covariance, x))
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
    return SelfCalibration(lens, reason, observations.groups, against, learnt.rms_px, covariance)


def sampled_observations(
    log: DriveLog, settings: OdometrySettings, matches: FloatArray | None = None, threads: int = 1
) -> CalibrationObservations:
    """GROUPS match groups or fewer from STRETCHES parts of a drive; what a part lacks of its share those after it make good."""
    right_rectifier = rows.RightRectifier(log.rig, IDENTITY, frame_source.fit_rows(log, settings.row_frames, matches=matches))
    count = max(1, min(STRETCHES, len(log) // LEAST_FRAMES))
    starts = [k * len(log) // count for k in range(count + 1)]
    wanted = [GROUPS * k // count for k in range(count + 1)]

    def stretch(k: int) -> tuple[Sampler, Iterator[int]]:
        sampler = Sampler(log, settings, right_rectifier, ObservationCollector(log.rig, POINTS))
        frames = iter(range(starts[k], min(starts[k + 1], starts[k] + MOST_FRAMES)))
        sampler.go_on(frames, wanted[k + 1] - wanted[k])
        return sampler, frames

    collector = ObservationCollector(log.rig, POINTS)
    for k, (sampler, frames) in enumerate(in_order(stretch, range(count), threads)):
        sampler.go_on(frames, wanted[k + 1] - len(collector.finished))
        collector.finished += sampler.collector.finished
    return collector.observations(log)
