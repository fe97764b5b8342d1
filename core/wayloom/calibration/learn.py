"""Calibration of a rig's relative lens: check that all drives are of one rig, adjust, state each parameter's standard deviation."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.adjustment import Adjustment, adjust, group_scores, lens_information
from wayloom.calibration.residuals import LENS, drive_of
from wayloom.calibration.rig_file import RigFile, differences
from wayloom.calibration.settings import CalibrationSettings
from wayloom.config.progress import Progress, silent
from wayloom.errors import CalibrationError
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.lens import PARAMETERS, RightLens, lens_field, parameter_jacobian
from wayloom.odometry.rig.calibration_observations import CalibrationObservations

FloatArray = NDArray[np.float64]
FIELD_STEP = 16
REGIONS = (6, 2)
"""Across and down: a region's matches share an error (interpolation, occlusion, slanted surfaces), however many they are."""
REGION_DEPTHS_M = (10.0, 50.0)
BAD_PX = 1.0
"""A lens that moves pixels by more anywhere is a bad calibration, worth telling."""
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
    used, left_out, doubts = _usable(observations, known, settings)
    progress(0.0, f"adjusting {sum(len(e) for e in used)} points of {len(used)} drives")
    prior_H = np.diag(1.0 / settings.lens.sigmas**2)
    start, old_H, old_g = RightLens(), np.zeros((LENS, LENS)), np.zeros(LENS)
    if known is not None:
        start, old_H, old_g = known.lens, known.information[:LENS, :LENS], known.pull[:LENS]
    fit = adjust([drive_of(e) for e in used], settings, prior_H + old_H, old_g, start)
    if not fit.converged:
        doubts = (*doubts, "the adjustment did not settle: the drives may be of different rigs, or their matches wrong")
    rig = _rig_file(used, fit, known, settings)
    progress(1.0, "done")
    worst, rms = field_size(rig.lens, rig.rig.camera)
    covariance, radial = _covariance(rig, settings)
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


def _rig_file(
    used: list[CalibrationObservations], fit: Adjustment, known: RigFile | None, settings: CalibrationSettings
) -> RigFile:
    """What was learnt, with standard deviations that hold for matches whose errors are correlated.

    What the drives say is weakened by how much their groups contradict each other beyond the noise of single matches.
    """
    H, g = lens_information(fit, settings)
    prior = np.diag(1.0 / settings.lens.sigmas**2)
    old_H = 0.0 if known is None else known.information[:LENS, :LENS]
    scores = np.concatenate([group_scores(fit, d, settings) for d in range(len(used))])
    sandwich, model = _sandwich(H[:LENS, :LENS] + old_H + prior, scores), np.linalg.inv(H[:LENS, :LENS] + prior)
    weaker = max(1.0, float(np.median(np.diag(sandwich) / np.diag(model))))
    x = np.append(fit.lens.values - RightLens().values, 0.0)
    information, pull = 0.5 * (H + H.T) / weaker, (g + H @ x) / weaker
    drives = tuple(e.name for e in used)
    matches = sum(int(np.isfinite(e.uv_right[:, 0]).sum() + np.isfinite(e.uv_left_target[..., 0]).sum()) for e in used)
    rig_id, rig = next((e.rig_id for e in used if e.rig_id is not None), None), used[0].rig
    if known is not None:
        information, pull = information + known.information, pull + known.pull
        drives, matches = (*known.drives, *drives), matches + known.matches
        rig_id, rig = known.rig_id or rig_id, known.rig
    learnt = RigFile(
        rig_id, rig, tuple(sorted(drives)), fit.lens, np.zeros(LENS), np.zeros(LENS, bool), information, pull, matches,
        float(fit.noise_px[0]),
    )  # fmt: skip
    sigma = np.sqrt(np.maximum(np.diag(_covariance(learnt, settings)[0]), np.diag(sandwich)))
    return replace(learnt, sigma=sigma, determined=sigma < settings.least_information * settings.lens.sigmas)


def _sandwich(H: FloatArray, scores: FloatArray) -> FloatArray:
    """(10, 10) covariance by the spread of the groups' own pulls (S, 10): H^-1 (sum s s^T) H^-1 S / (S - 1) (Huber 1967, White
    1980). Errors that all matches of a group share count as one."""
    S, inverse = len(scores), np.linalg.inv(H)
    return np.asarray(inverse @ (scores.T @ scores) @ inverse * S / max(S - 1, 1))


def _covariance(rig: RigFile, settings: CalibrationSettings) -> tuple[FloatArray, float]:
    """(10, 10) of the parameters by what the drives say and the prior, and the radial error that both lenses seem to share.

    That error is not part of the lens, so the lens is learnt as if there were none; what it then does to the parameters is added to
    the covariance, shift shift^T (kappa^2 + sigma_kappa^2), shift = -d lens / d kappa; so is what the matches of a region share.
    """
    H, coupling = rig.information[:LENS, :LENS] + np.diag(1.0 / settings.lens.sigmas**2), rig.information[:LENS, LENS]
    inverse = np.linalg.inv(H)
    shift = inverse @ coupling
    variance = 1.0 / (rig.information[LENS, LENS] - coupling @ shift + 1.0 / settings.common_radial**2)
    kappa = variance * (rig.pull[LENS] - shift @ rig.pull[:LENS])
    common = np.outer(shift, shift) * (kappa**2 + variance)
    return np.asarray(inverse + common + _shared_covariance(rig, settings)), float(kappa)


def chi_square(rig: RigFile, settings: CalibrationSettings) -> float:
    """x^T C^-1 x of the lens's difference x (10,) from the ideal camera's: ten or so where the ideal one is the true one."""
    x = rig.lens.values - RightLens().values
    return float(x @ np.linalg.solve(_covariance(rig, settings)[0], x))


def _shared_covariance(rig: RigFile, settings: CalibrationSettings) -> FloatArray:
    """(10, 10): what can be known at best where every region of the image shares an error of shared_px in both directions."""
    camera, (across, down) = rig.rig.camera, REGIONS
    v, u = np.mgrid[0:down, 0:across].astype(float)
    uv = np.column_stack([(u.ravel() + 0.5) * camera.width / across, (v.ravel() + 0.5) * camera.height / down])
    H = np.diag(1.0 / settings.lens.sigmas**2)
    for depth_m in REGION_DEPTHS_M:
        J = parameter_jacobian(rig.lens, camera, rig.rig.baseline_m, uv, 1.0 / depth_m)
        H += np.einsum("nki,nkj->ij", J, J) / (len(REGION_DEPTHS_M) * settings.shared_px**2)
    return np.asarray(np.linalg.inv(H), np.float64)


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


def field_sigma(lens: RightLens, camera: PinholeCamera, covariance: FloatArray) -> float:
    """The largest standard deviation, px, of where a lens of this covariance (10, 10) moves a pixel, mean shift taken off."""
    v, u = np.mgrid[0 : camera.height : 4 * FIELD_STEP, 0 : camera.width : 4 * FIELD_STEP].astype(float)
    J = parameter_jacobian(lens, camera, 0.0, np.column_stack([u.ravel(), v.ravel()]))
    J[:, 0] -= J[:, 0].mean(axis=0)
    variance = np.einsum("nij,jk,nik->n", J, covariance, J)
    return math.sqrt(max(float(variance.max()), 0.0))


def undetermined(rig: RigFile) -> tuple[str, ...]:
    """Names of the parameters that the drives leave as unknown as before; they stay near the ideal camera's by their prior."""
    return tuple(name for name, known in zip(PARAMETERS, rig.determined, strict=True) if not known)
