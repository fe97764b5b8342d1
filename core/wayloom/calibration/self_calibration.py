"""Self-calibration of a drive whose rig has no file: the lens learnt from a few pieces of the drive before it is tracked.

A lens is used only where the observations contradict the ideal camera: x^T C^-1 x, x the ten parameters' differences and C their
covariance with everything in it that `learn` knows, is beyond what chance does to an ideal camera once in a thousand drives, and
where the lens moves pixels by so much that leaving it alone costs more than not knowing it well. So a rig that is calibrated well
loses nothing, to the bit. docs/calibration.md has the numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from time import process_time
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.baseline import joint_covariance
from wayloom.calibration.covariance import lens_covariance
from wayloom.calibration.learn import learn_rig
from wayloom.calibration.rig_file import RigFile
from wayloom.calibration.sampling import Sampler
from wayloom.calibration.scale import scale_facts
from wayloom.calibration.settings import CalibrationSettings
from wayloom.calibration.shrinkage import STEP
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


def track_calibrated(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), progress: Progress = silent, threads: int = 1,
    lens: RightLens | None = None, observers: Sequence[Observer] = (), matches: FloatArray | None = None,
    rig: RigFile | None = None,
) -> OdometryResult:  # fmt: skip
    """As `wayloom.odometry.odometry.track`, with what a rig's file knows, or with a lens; without either the drive's own is learnt
    first, and told in the report. matches : of the first pairs, as of `frame_source.first_matches`, where the caller has them.

    Where an ObservationCollector is among the observers, `report["scale"]` tells the scale's sigma (`scale.scale_facts`).
    """
    if rig is not None:
        return _track_with_rig(log, settings, progress, threads, rig, observers, matches)
    if lens is not None or not settings.self_calibration:
        return track(log, settings, progress, threads, IDENTITY if lens is None else lens, observers, matches)
    frame_source.check_rig(log)
    warm_up.compile_odometry(False, progress)
    start = process_time()
    progress(0.0, "learning the right camera's lens from pieces of the drive")
    if matches is None:
        with frame_source.one_opencv_thread():
            matches = frame_source.first_matches(log, settings.row_frames)
    own = self_calibrated_lens(log, settings, matches)
    seconds = process_time() - start
    if not own.lens.is_ideal:
        settings = with_bias_sigma(settings, BIAS_SIGMA_PX)
    result = track(log, settings, progress, threads, own.lens, observers, matches)
    result.report["self_calibration"] = {
        "used": not own.lens.is_ideal, "why": own.reason, "match_groups": own.groups,
        "chi_square": None if np.isnan(own.chi_square) else round(own.chi_square, 1),
        "moves_px": None if np.isnan(own.rms_px) else round(own.rms_px, 3),
    }  # fmt: skip
    result.report["seconds"]["own lens"] = round(seconds, 4)
    learning = CalibrationSettings()
    _tell_scale(result, log, observers, 1.0, joint_covariance(own.covariance, learning.baseline_sigma), learning)
    return result


def _track_with_rig(
    log: DriveLog, settings: OdometrySettings, progress: Progress, threads: int, rig: RigFile, observers: Sequence[Observer],
    matches: FloatArray | None,
) -> OdometryResult:  # fmt: skip
    learning = CalibrationSettings()
    bias_sigma_px = learning.drive.disparity_bias_px if rig.bias_sigma_px is None else rig.bias_sigma_px
    if rig.bias_sigma_px is not None:
        settings = with_bias_sigma(settings, bias_sigma_px)
    covariance = rig.covariance
    if covariance is None:
        covariance = joint_covariance(lens_covariance(rig, learning)[0], learning.baseline_sigma)
    result = track(log, settings, progress, threads, rig.lens, observers, matches, rig.baseline_ratio)
    of_drive = learning.model_copy(update={"drive": learning.drive.model_copy(update={"disparity_bias_px": bias_sigma_px})})
    _tell_scale(result, log, observers, rig.baseline_ratio, covariance, of_drive)
    return result


def with_bias_sigma(settings: OdometrySettings, sigma_px: float) -> OdometrySettings:
    """The settings with a disparity bias that is known about zero to sigma_px at least."""
    known = (settings.grey_sigma / sigma_px) ** 2
    return settings.model_copy(update={"bias_prior": max(settings.bias_prior, known)})


def _tell_scale(
    result: OdometryResult, log: DriveLog, observers: Sequence[Observer], baseline_ratio: float, covariance: FloatArray,
    settings: CalibrationSettings,
) -> None:  # fmt: skip
    """Write the scale's sigma into the report, as far as the drive's observations tell it; settings : those of the covariance."""
    collector = next((observer for observer in observers if isinstance(observer, ObservationCollector)), None)
    if collector is None:
        return
    observations = collector.observations(log)
    if observations.groups:
        result.report["scale"] = scale_facts(observations, result.lens, baseline_ratio, covariance, settings)


def self_calibrated_lens(
    log: DriveLog, settings: OdometrySettings = OdometrySettings(), matches: FloatArray | None = None
) -> SelfCalibration:
    """The lens that a drive tells of. matches : as of `track`. Raises as it does."""
    with frame_source.one_opencv_thread():
        observations = sampled_observations(log, settings, matches)
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


def sampled_observations(log: DriveLog, settings: OdometrySettings, matches: FloatArray | None = None) -> CalibrationObservations:
    """GROUPS match groups or fewer from STRETCHES parts of a drive."""
    right_rectifier = rows.RightRectifier(log.rig, IDENTITY, frame_source.fit_rows(log, settings.row_frames, matches=matches))
    collector, count = ObservationCollector(log.rig, POINTS), max(1, min(STRETCHES, len(log) // LEAST_FRAMES))
    sampler, starts = Sampler(log, settings, right_rectifier, collector), [k * len(log) // count for k in range(count + 1)]
    for k, start in enumerate(starts[:-1]):
        sampler.stretch(start, min(starts[k + 1], start + MOST_FRAMES), GROUPS * (k + 1) // count)
    return collector.observations(log)
