"""Covariance of a learnt lens: cluster-robust (sandwich) estimator over match groups, and errors that no group shows.

Match groups are the clusters, since the matches of a group share errors (Huber 1967; Liang and Zeger 1986):

    C = B^-1 (M + K + P) B^-1,    B = sum_s h_s + K + P,

h_s a group's curvature, M the scatter of the groups' scores, P the lens's prior and K what the prior of the drives' own offsets
adds: both are beliefs about random terms, so that their scores have the variance that their information says. Two corrections: the
curvature is that of the Cauchy energy, not of its reweighted squares; M is the scatter that the scores would have had the lens not
been fitted to them (Bell and McCaffrey 2002), and from few groups leans towards one dispersion for all parameters.
"""

import math

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.adjustment import Adjustment, curvature_ratio, group_scores
from wayloom.calibration.residuals import LENS, Drive, jacobians, residuals
from wayloom.calibration.rig_file import RigFile
from wayloom.calibration.score_moments import ScoreMoments, moments_of
from wayloom.calibration.settings import CalibrationSettings
from wayloom.geometry.camera import PinholeCamera
from wayloom.geometry.lens import RightLens, parameter_jacobian

FloatArray = NDArray[np.float64]
REGIONS = (8, 3)
"""Of the right image, across and down: a region's matches share an error (lens beyond the model, interpolation, slants)."""
REGION_DEPTHS_M = (10.0, 50.0)
REGION_POINTS = 20
"""A region of fewer says nothing about a shared error."""
SEEN_BY_ROWS = 1e-2
"""px that a parameter's prior sigma must move the regions' rows by to count as fitted to them."""
LEAN_GROUPS = LENS
"""The common dispersion counts as much as so many match groups."""


def lens_covariance(rig: RigFile, settings: CalibrationSettings) -> tuple[FloatArray, float]:
    """(10, 10) of the lens's parameters, and the radial error k1 that both lenses seem to share.

    That radial error is not part of the lens, so the lens is learnt as if there were none; what it then does to the parameters is
    added to the covariance, shift shift^T (kappa^2 + sigma_kappa^2), shift = -d lens / d kappa; so is what the matches of a region
    share.
    """
    prior = np.diag(1.0 / settings.lens.sigmas**2)
    information = rig.information[:LENS, :LENS]
    robust = sandwich(information, rig.scores or ScoreMoments(), rig.lens.values - RightLens().values, prior)
    H, coupling = information + prior, rig.information[:LENS, LENS]
    dispersion = float(np.trace(H @ robust)) / LENS
    shift = np.linalg.solve(H, coupling)
    variance = 1.0 / ((rig.information[LENS, LENS] - coupling @ shift) / dispersion + 1.0 / settings.common_radial**2)
    kappa = variance * (rig.pull[LENS] - shift @ rig.pull[:LENS]) / dispersion
    common = np.outer(shift, shift) * (kappa**2 + variance)
    return np.asarray(robust + common + shared_covariance(rig, settings)), float(kappa)


def sandwich(information: FloatArray, scores: ScoreMoments, x: FloatArray, prior: FloatArray) -> FloatArray:
    """(10, 10) covariance C of a lens x (10,) by the information (10, 10) of drives, their groups' scores and a prior (10, 10)."""
    bread, curvature = information + prior, scores.curvature
    inverse = np.asarray(np.linalg.inv(bread), np.float64)
    meat = _scatter_of_errors(scores, x, inverse) if scores.groups else curvature
    return np.asarray(inverse @ (meat + bread - curvature) @ inverse)


def _scatter_of_errors(scores: ScoreMoments, x: FloatArray, inverse: FloatArray) -> FloatArray:
    """(10, 10) M: the scatter of the scores at the true lens, from that at the learnt one x (10,), of which the fit took a part."""
    curvature, found = scores.curvature, scores.scatter(x)
    left = curvature - scores.leverage(inverse)
    unit = np.sqrt(np.diag(inverse))
    scale = np.outer(unit, unit)
    correction = _power(curvature * scale, 0.5) @ _power(left * scale, -0.5)
    corrected = correction @ (found * scale) @ correction.T / scale
    dispersion = float(np.trace(inverse @ found) / np.trace(inverse @ left))
    return np.asarray((scores.groups * corrected + LEAN_GROUPS * dispersion * curvature) / (scores.groups + LEAN_GROUPS))


def _power(H: FloatArray, exponent: float) -> FloatArray:
    """H^exponent of a symmetric positive matrix, directions without information left out."""
    values, vectors = np.linalg.eigh(0.5 * (H + H.T))
    known = values > 1e-9 * values.max(initial=1e-300)
    return np.asarray((vectors[:, known] * values[known] ** exponent) @ vectors[:, known].T)


def score_moments(fit: Adjustment, drives: list[Drive], settings: CalibrationSettings) -> ScoreMoments:
    """What the drives of an adjustment say of its covariance."""
    total = ScoreMoments()
    x = fit.lens.values - RightLens().values
    for d, drive in enumerate(drives):
        total += ScoreMoments(moments_of(*group_scores(fit, d, settings), x), *_region_errors(fit, d, drive, settings))
    return total


def _region_errors(fit: Adjustment, d: int, drive: Drive, settings: CalibrationSettings) -> tuple[float, float]:
    """Excess, px^2, and degrees of freedom of the mean row residuals of a drive's right matches over REGIONS.

    Rows, because depths take up errors along the columns. What a lens could explain is projected out of the means m (R,), so that
    the result is the same about any lens: with P that projection and V the variances of m by match groups,
    E[m^T P m] = tr(P V) + tr(P) shared^2. Robust weights answer to an error only as far as the energy is curved: hence the ratio.
    """
    weight, group = fit.weights[d][:, 0], drive.observations.group
    r = residuals(drive, fit.lens, fit.states[d])[:, 0, 1]
    J = jacobians(drive, fit.lens, fit.states[d])[0][:, 0, 1, :LENS]
    region = _region(drive.measured[:, 0], drive.observations.rig.camera)
    means, variances, rows = [], [], []
    for k in range(REGIONS[0] * REGIONS[1]):
        mine = (region == k) & (weight > 0)
        groups, cluster = np.unique(group[mine], return_inverse=True)
        if mine.sum() < REGION_POINTS or len(groups) < 2:
            continue
        w, total = weight[mine], weight[mine].sum()
        mean = float(w @ r[mine]) / total
        pulls = np.bincount(cluster, w * (r[mine] - mean))
        means.append(mean)
        variances.append(float((pulls**2).sum()) / total**2 * len(groups) / (len(groups) - 1))
        rows.append(w @ J[mine] / total)
    if not means:
        return 0.0, 0.0
    U, size, _ = np.linalg.svd(np.array(rows) * settings.lens.sigmas, full_matrices=False)
    fitted = U[:, size > SEEN_BY_ROWS]
    P, m = np.eye(len(means)) - fitted @ fitted.T, np.array(means)
    return float(m @ P @ m - np.diag(P) @ variances) / curvature_ratio(fit.weights[d]) ** 2, max(float(np.trace(P)), 0.0)


def _region(pixels: FloatArray, camera: PinholeCamera) -> NDArray[np.intp]:
    """(P,) number of the region in which pixels (P, 2) lie."""
    size = np.array([camera.width, camera.height]) / REGIONS
    across, down = np.clip(pixels // size, 0, np.array(REGIONS) - 1).astype(np.intp).T
    return np.asarray(across + REGIONS[0] * down)


def shared_covariance(rig: RigFile, settings: CalibrationSettings) -> FloatArray:
    """(10, 10): what can be known at best where every region of the image shares an error, in both directions, of the size that the
    rows of its matches show."""
    shared_px2 = 0.0 if rig.scores is None else rig.scores.shared_px2
    if shared_px2 == 0.0:
        return np.zeros((LENS, LENS))
    camera, (across, down) = rig.rig.camera, REGIONS
    v, u = np.mgrid[0:down, 0:across].astype(float)
    uv = np.column_stack([(u.ravel() + 0.5) * camera.width / across, (v.ravel() + 0.5) * camera.height / down])
    H = np.diag(1.0 / settings.lens.sigmas**2)
    for depth_m in REGION_DEPTHS_M:
        J = parameter_jacobian(rig.lens, camera, rig.rig.baseline_m, uv, 1.0 / depth_m)
        H += np.einsum("nki,nkj->ij", J, J) / (len(REGION_DEPTHS_M) * shared_px2)
    return np.asarray(np.linalg.inv(H), np.float64)


def field_sigma(lens: RightLens, camera: PinholeCamera, covariance: FloatArray, step: int = 64) -> float:
    """The largest standard deviation, px, of where a lens of this covariance (10, 10) moves a pixel, mean shift taken off."""
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step].astype(float)
    J = parameter_jacobian(lens, camera, 0.0, np.column_stack([u.ravel(), v.ravel()]))
    J[:, 0] -= J[:, 0].mean(axis=0)
    variance = np.einsum("nij,jk,nik->n", J, covariance, J)
    return math.sqrt(max(float(variance.max()), 0.0))
