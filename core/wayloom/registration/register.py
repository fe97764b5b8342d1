"""Registration of two place views: hypotheses, refinement, checks, and a covariance that errors agree with."""

from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.places.types import PlaceView
from wayloom.registration.distinctness import distinctness
from wayloom.registration.feature_evidence import feature_evidence
from wayloom.registration.matches import GATE2, SIGMA_PX, Matches, equations, errors2, match, pose_of_matches
from wayloom.registration.refinement import STAGES, Fit, refine, with_height
from wayloom.registration.scene import Scene, prepare
from wayloom.registration.search import Gate, hypotheses, level_pose, turn
from wayloom.registration.settings import RegistrationSettings
from wayloom.registration.types import Registration
from wayloom.registration.verification import both_ways, refusal, soundness

FloatArray = NDArray[np.float64]
COARSE_POINTS: Final = 500
"""Points that weigh hypotheses against each other."""
FINE_POINTS: Final = 2000
REFINED: Final = 4
"""Hypotheses that are refined with all points and checked."""
SAME_M, SAME_RAD = 1.5, np.deg2rad(5.0)
"""Poses nearer than this to each other are one."""
POLISHING: Final = 8
LOOKS_ALIKE_M, LOOKS_ALIKE_RAD, LEAST_FEATURES = 8.0, np.deg2rad(30.0), 200
SURFACE_INFLATION, MATCH_INFLATION = 10.0, 4.0
"""How many points share one error: of surfaces, and of features, each of which is seen from several keyframes."""
BEND_M, BEND_SHARE = 0.02, 0.01
BEND_RAD, BEND_RAD_PER_M = float(np.deg2rad(0.05)), float(np.deg2rad(0.03))
"""Views bend by the drift of the odometry within them: so much, and more with the way between the two anchors."""


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of T_a_b before: (4, 4), and the covariance (6, 6) of its left perturbation (v, omega), m^2 and rad^2."""

    T_a_b: FloatArray
    covariance: FloatArray


def register(
    view_a: PlaceView, view_b: PlaceView, prior: Prior | None = None, settings: RegistrationSettings = RegistrationSettings()
) -> Registration:
    """The pose of b in a, or why there is none to be believed."""
    return register_scenes(prepare(view_a, settings), prepare(view_b, settings), prior, settings)


def register_scenes(a: Scene, b: Scene, prior: Prior | None, settings: RegistrationSettings) -> Registration:
    """`register` for views that are prepared."""
    if min(len(a), len(b)) < settings.min_points:
        return refused(f"a view has only {min(len(a), len(b))} points", {})
    matches = match(a.view, b.view)
    starts = [T for T, _ in hypotheses(a, b, gate_of(prior, settings), settings)]
    by_features = pose_of_matches(*matches)
    if by_features is not None and by_features[1] >= settings.min_matches:
        starts.insert(0, by_features[0])
    coarse = [refine(a, b, with_height(a, b, T), STAGES[:2], COARSE_POINTS) for T in starts]
    fits = [refine(a, b, fit.T_a_b, STAGES[1:], FINE_POINTS) for fit in distinct(coarse)[:REFINED]]
    judged = [judge(a, b, fit, matches, prior, settings) for fit in distinct(fits)]
    if not judged:
        return refused("no pose is near the prior", {})
    return decide(judged, settings)


def gate_of(prior: Prior | None, settings: RegistrationSettings) -> Gate:
    """Where the search looks: everywhere within its reach, or near the prior."""
    if prior is None:
        return Gate(np.zeros(3), None, settings.search_m, settings.prior_sigmas)
    T = prior.T_a_b
    # x, y of the origin of b move by v + omega x t; only the turn about z is searched.
    J = np.zeros((3, 6))
    J[:2, :3], J[:2, 3:], J[2, 5] = np.eye(3)[:2], -se3.hat(T[:3, 3])[:2], 1.0
    mean = np.array([T[0, 3], T[1, 3], yaw_of(T)])
    return Gate(mean, J @ prior.covariance @ J.T, settings.search_m, settings.prior_sigmas)


def yaw_of(T: FloatArray) -> float:
    """Heading of a nearly level pose, rad."""
    return float(np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1]))


def distinct(fits: list[Fit]) -> list[Fit]:
    """The fits by falling score, each unlike all better ones."""
    out: list[Fit] = []
    for fit in sorted(fits, key=lambda f: (-f.score, *f.T_a_b.ravel())):
        if all(is_other(fit.T_a_b, better.T_a_b) for better in out):
            out.append(fit)
    return out


def is_other(T: FloatArray, T_other: FloatArray) -> bool:
    """Whether two poses are so far apart that they are two answers."""
    apart = float(np.linalg.norm(T[:3, 3] - T_other[:3, 3]))
    return apart > SAME_M or abs(turn(yaw_of(T) - yaw_of(T_other))) > SAME_RAD


def judge(
    a: Scene, b: Scene, fit: Fit, matches: tuple[Matches, Matches], prior: Prior | None, settings: RegistrationSettings
) -> Registration:
    """A fit polished by the features that agree with it, with its evidence."""
    T, covariance, inliers = polish(a, b, fit, matches, settings)
    evidence: dict[str, Any] = {name: round(value, 4) for name, value in both_ways(a, b, T).items()}
    evidence |= {
        "score": round(fit.score, 4),
        "matches": len(matches[0]),
        "inliers": inliers,
        "sigma_m": round(float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])), 4),
    }
    if inliers >= settings.many_matches:
        evidence |= feature_evidence(*matches, T)
    words = refusal(evidence, settings, prior is not None)
    if inliers < settings.min_matches and looks_alike(a.view, b.view, T):
        words = words or f"both look the same way and only {inliers} local features agree"
    if not words and inliers < settings.many_matches:
        evidence["distinctness"] = round(distinctness(a, b, T, covariance) / max(evidence["overlap"], 1e-6), 4)
        least = settings.min_distinctness_same_way if abs(yaw_of(T)) < LOOKS_ALIKE_RAD else settings.min_distinctness
        if evidence["distinctness"] < least:
            words = f"it fits nearly as well elsewhere along the street (distinctness {evidence['distinctness']:.2f})"
    if prior is not None:
        xi = se3.log(T @ se3.inverse(prior.T_a_b))
        evidence["prior_chi2"] = round(float(xi @ np.linalg.solve(prior.covariance + covariance, xi)), 2)
        if evidence["prior_chi2"] > settings.max_prior_chi2:
            words = words or f"the prior denies it (chi-square {evidence['prior_chi2']:.0f} of 6)"
    return Registration(T, covariance, words, evidence)


def looks_alike(a: PlaceView, b: PlaceView, T_a_b: FloatArray) -> bool:
    """Whether by this pose both cameras look the same way from nearly one place, so that their local features must agree."""
    known = min(len(a.features), len(b.features)) >= LEAST_FEATURES
    near = float(np.linalg.norm(T_a_b[:3, 3])) < LOOKS_ALIKE_M
    return known and near and abs(yaw_of(T_a_b)) < LOOKS_ALIKE_RAD


def polish(
    a: Scene, b: Scene, fit: Fit, matches: tuple[Matches, Matches], settings: RegistrationSettings
) -> tuple[FloatArray, FloatArray, int]:
    """Pose, covariance (6, 6) and number of agreeing features of surfaces and features together."""
    T, count = fit.T_a_b, len(matches[0])
    for _ in range(POLISHING):
        inliers = int((errors2(T, *matches, SIGMA_PX) < GATE2).sum()) if count else 0
        if inliers < settings.min_matches:
            return T, covariance_of(T, fit.H, np.zeros((6, 6))), inliers
        refined = refine(a, b, T, ((STAGES[-1][0], STAGES[-1][1], 0),), FINE_POINTS)
        H_matches, g_matches = equations(T, *matches, SIGMA_PX)
        H, g = (
            refined.H / SURFACE_INFLATION + H_matches / MATCH_INFLATION,
            refined.g / SURFACE_INFLATION + g_matches / MATCH_INFLATION,
        )
        xi = np.asarray(np.linalg.solve(H + 1e-3 * np.eye(6), g), np.float64)
        T, fit = se3.exp(xi) @ T, refined
        if np.abs(xi).max() < 1e-4:
            break
    return T, covariance_of(T, refined.H, H_matches), inliers


def covariance_of(T_a_b: FloatArray, H_surfaces: FloatArray, H_matches: FloatArray) -> FloatArray:
    """(6, 6) of the left perturbation. Neighbouring points share their errors, so that their information counts for a part only,
    and both views have bent by their own drift, which no number of points shows."""
    tilt = np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 0.0]) / np.deg2rad(2.0) ** 2
    H = H_surfaces / SURFACE_INFLATION + H_matches / MATCH_INFLATION + tilt + 1e-6 * np.eye(6)
    covariance: FloatArray = np.linalg.inv(H) + bend_covariance(T_a_b)
    return 0.5 * (covariance + covariance.T)


def bend_covariance(T_a_b: FloatArray) -> FloatArray:
    """(6, 6) of the left perturbation: what the views' own bending adds, the more the further apart their anchors are."""
    apart = float(np.linalg.norm(T_a_b[:3, 3]))
    bend_m, bend_rad = BEND_M + BEND_SHARE * apart, BEND_RAD + BEND_RAD_PER_M * apart
    return np.diag([bend_m**2] * 3 + [bend_rad**2] * 3)


def decide(judged: list[Registration], settings: RegistrationSettings) -> Registration:
    """The best pose, where it passes all checks and no other one is nearly as good, whether that passes them or not."""
    best, *others = sorted(judged, key=lambda r: (-quality(r), *r.T_a_b.ravel()))
    for other in others:
        lead = quality(best) / max(quality(other), 1e-6)
        if best.refused or lead >= settings.min_lead or not is_other(other.T_a_b, best.T_a_b) or by_features(best, other, settings):
            continue
        apart = float(np.linalg.norm(best.T_a_b[:3, 3] - other.T_a_b[:3, 3]))
        words = f"another pose, {apart:.1f} m beside it, is nearly as good (1 to {lead:.2f})"
        return replace(best, refused=words, evidence=best.evidence | {"lead": round(lead, 3)})
    return best


def quality(registration: Registration) -> float:
    """How well a pose fits, less for classes that disagree, and much less for points where the other view saw through."""
    return float(registration.evidence["score"]) * soundness(registration.evidence)


def by_features(best: Registration, other: Registration, settings: RegistrationSettings) -> bool:
    """Whether local features tell two poses apart."""
    inliers = best.evidence["inliers"]
    return bool(inliers >= 2 * settings.min_matches and inliers >= 3 * other.evidence["inliers"])


def refused(words: str, evidence: dict[str, Any]) -> Registration:
    """A refusal without a pose."""
    return Registration(level_pose(0.0, 0.0, 0.0, 0.0), np.full((6, 6), np.nan), words, evidence)
