"""Calibration of a rig's relative lens: check that all drives are of one rig, adjust, state each parameter's standard deviation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.adjustment import Adjustment, adjust, lens_expansion
from wayloom.calibration.covariance import field_sigma, lens_covariance, score_moments
from wayloom.calibration.residuals import LENS, Drive, drive_of
from wayloom.calibration.rig_file import RigFile, differences
from wayloom.calibration.score_moments import ScoreMoments
from wayloom.calibration.settings import CalibrationSettings
from wayloom.config.progress import Progress, silent
from wayloom.errors import CalibrationError
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.lens import PARAMETERS, RightLens, lens_field
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

FloatArray = NDArray[np.float64]
FIELD_STEP = 16
BAD_PX = 1.0
"""A lens that moves pixels by more anywhere is a bad calibration, worth telling."""
LEARN_ANEW = "learn it again from the observations of all its drives, or from their logs: wayloom calibrate LOG… --out RIG.toml"
DRIVE_MORE = "drive with turns, at different speeds and along different streets, and give the observations of these drives too"


@dataclass(frozen=True, slots=True)
class DriveOutcome:
    """What was found of one drive beside the rig's lens. weight: mean of its matches' weights, 0 to 1: a low one does not fit."""

    name: str
    groups: int
    points: int
    disparity_bias_px: float
    pitch_rad: float
    roll_rad: float
    weight: float


@dataclass(frozen=True, slots=True)
class Calibration:
    """A rig as learnt, and what people want to know of it.

    drives        those that were used now, in the order given
    left_out      names of drives that were not used, with the reason
    worst_px, rms_px   how far the lens moves pixels, at most and on average, its mean shift of the columns taken off: a drive's own
                  disparity bias takes that
    unsure_px     the largest standard deviation of where it moves a pixel, on the same terms
    common_radial k1 of a radial error that both lenses seem to share; rectification left it, the rig's file does not hold it
    doubts        what speaks against the result, in words
    converged     whether the adjustment settled
    """

    rig: RigFile
    drives: tuple[DriveOutcome, ...]
    left_out: tuple[tuple[str, str], ...]
    worst_px: float
    rms_px: float
    unsure_px: float
    common_radial: float
    doubts: tuple[str, ...]
    converged: bool


def learn_rig(
    observations: Sequence[CalibrationObservations],
    settings: CalibrationSettings = CalibrationSettings(),
    known: RigFile | None = None,
    progress: Progress = silent,
) -> Calibration:
    """Learn the lens of the rig that recorded all of `observations`, on top of what is known of it.

    Raises CalibrationError where the observations are of different rigs, of drives that are known already, or too little.
    """
    if known is not None and known.scores is None:
        raise CalibrationError("the rig file is of format 1 and holds no sums of scores to add drives to", remedy=LEARN_ANEW)
    used, left_out, doubts = _usable(observations, known, settings)
    progress(0.0, f"adjusting {sum(len(e) for e in used)} points of {len(used)} drives")
    prior_H = np.diag(1.0 / settings.lens.sigmas**2)
    start, old_H, old_g = RightLens(), np.zeros((LENS, LENS)), np.zeros(LENS)
    if known is not None:
        start, old_H, old_g = known.lens, known.information[:LENS, :LENS], known.pull[:LENS]
    drives = [drive_of(e) for e in used]
    fit = adjust(drives, settings, prior_H + old_H, old_g, start)
    if not fit.converged:
        doubts = (*doubts, "the adjustment did not settle: the drives may be of different rigs, or their matches wrong")
    rig = _rig_file(drives, fit, known, settings)
    progress(1.0, "done")
    worst, rms = field_size(rig.lens, rig.rig.camera)
    covariance, radial = lens_covariance(rig, settings)
    unsure = field_sigma(rig.lens, rig.rig.camera, covariance)
    outcomes = tuple(_outcome(e, fit, d) for d, e in enumerate(used))
    return Calibration(rig, outcomes, left_out, worst, rms, unsure, radial, doubts, fit.converged)


def _usable(
    observations: Sequence[CalibrationObservations], known: RigFile | None, settings: CalibrationSettings
) -> tuple[list[CalibrationObservations], tuple[tuple[str, str], ...], tuple[str, ...]]:
    """The drives to learn from, those left out and why, and doubts. Raises CalibrationError."""
    used: list[CalibrationObservations] = []
    left_out: list[tuple[str, str]] = []
    doubts: list[str] = []
    names = set() if known is None else set(known.drives)
    for drive in observations:
        if drive.name in names:
            left_out.append((drive.name, "it is learnt from already"))
        elif not drive.groups:
            left_out.append((drive.name, "it holds no matches: too short, or it stood still"))
        else:
            used.append(drive)
            names.add(drive.name)
            first = used[0] if known is None else known
            of_first = RigFile(first.rig_id, first.rig, (), RightLens(), np.zeros(LENS), np.zeros(LENS, bool))
            doubts += [f"{drive.name}: {doubt}" for doubt in differences(of_first, drive.rig, drive.rig_id, file=drive.name)]
    groups = sum(drive.groups for drive in used)
    if groups < settings.least_groups:
        reasons = "; ".join(f"{name}: {why}" for name, why in left_out)
        what = f"{groups} groups of matches in {len(used)} drives are too few to learn from{f' ({reasons})' if reasons else ''}"
        raise CalibrationError(what, remedy=DRIVE_MORE)
    return used, tuple(left_out), tuple(doubts)


def _rig_file(drives: list[Drive], fit: Adjustment, known: RigFile | None, settings: CalibrationSettings) -> RigFile:
    """What was learnt, and standard deviations that hold for matches whose errors are correlated. Sums of drives add."""
    H, g = lens_expansion(fit, settings)
    x = np.append(fit.lens.values - RightLens().values, 0.0)
    used = [drive.observations for drive in drives]
    rig_id = next((e.rig_id for e in used if e.rig_id is not None), None)
    matches = sum(int(np.isfinite(e.uv_right[:, 0]).sum() + np.isfinite(e.uv_left_target[..., 0]).sum()) for e in used)
    learnt = RigFile(
        rig_id, used[0].rig, tuple(sorted(e.name for e in used)), fit.lens, np.zeros(LENS), np.zeros(LENS, bool),
        0.5 * (H + H.T), g + H @ x, score_moments(fit, drives, settings), matches, float(fit.noise_px[0]),
    )  # fmt: skip
    if known is not None:
        learnt = _joined(learnt, known)
    sigma = np.sqrt(np.diag(lens_covariance(learnt, settings)[0]))
    return replace(learnt, sigma=sigma, determined=sigma < settings.least_information * settings.lens.sigmas)


def _joined(learnt: RigFile, known: RigFile) -> RigFile:
    """What drives say now and what earlier ones said, about the present lens."""
    return replace(
        learnt,
        rig_id=known.rig_id or learnt.rig_id,
        rig=known.rig,
        drives=tuple(sorted((*known.drives, *learnt.drives))),
        information=learnt.information + known.information,
        pull=learnt.pull + known.pull,
        scores=(learnt.scores or ScoreMoments()) + (known.scores or ScoreMoments()),
        matches=learnt.matches + known.matches,
        receivers=known.receivers,
    )


def _outcome(observations: CalibrationObservations, fit: Adjustment, d: int) -> DriveOutcome:
    weight, offsets = fit.weights[d], fit.states[d].offsets
    mean = float(weight[weight > 0].mean()) if (weight > 0).any() else 0.0
    bias, pitch, roll = (float(x) for x in offsets)
    return DriveOutcome(observations.name, observations.groups, len(observations), bias, pitch, roll, mean)


def field_size(lens: RightLens, camera: PinholeCamera) -> tuple[float, float]:
    """Largest and root mean square length, px, of how the lens moves pixels, the mean shift of the columns taken off."""
    field = lens_field(lens, camera, FIELD_STEP)
    field[..., 0] -= field[..., 0].mean()
    length = np.hypot(field[..., 0], field[..., 1])
    return float(length.max()), math.sqrt(float((length**2).mean()))


def undetermined(rig: RigFile) -> tuple[str, ...]:
    """Names of the parameters that the drives leave as unknown as before; they stay near the ideal camera's by their prior."""
    return tuple(name for name, known in zip(PARAMETERS, rig.determined, strict=True) if not known)
