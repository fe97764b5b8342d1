"""Evidence for and against a pose: overlap, points where the other view saw through, classes of points that meet."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.registration.scene import FREE, GROUND, NEAR, VOXEL_M, Scene
from wayloom.registration.settings import RegistrationSettings

FloatArray = NDArray[np.float64]
SEEN_THROUGH_POWER = 5
SURE_M = 1.0
"""Points less certain along their ray are no witnesses."""


def meeting(a: Scene, b: Scene, T_a_b: FloatArray) -> dict[str, float]:
    """What a's voxels say of b's points, the ground left out: `overlap`, the share that stands where a saw anything; of those
    `through`, the share that stands in free space; of those near a point of a `agreement`, the share with one of its own group."""
    witnesses = (b.sigma_m < SURE_M) & (b.group != GROUND)
    index = np.floor((se3.transform(T_a_b, b.xyz[witnesses]) - a.origin) / VOXEL_M).astype(np.int64)
    inside = ((index >= 0) & (index < a.voxels.shape)).all(axis=1)
    i, j, k = index[inside].T
    voxel, group = a.voxels[i, j, k], b.group[witnesses][inside]
    near = voxel & NEAR
    through = voxel == FREE
    beside, own = near != 0, ((near >> group) & 1) != 0
    seen = int(through.sum() + beside.sum())
    return {
        "overlap": seen / max(int(witnesses.sum()), 1),
        "through": int(through.sum()) / max(seen, 1),
        "agreement": int(own.sum()) / max(int(beside.sum()), 1),
        "seen": float(seen),
    }


def both_ways(a: Scene, b: Scene, T_a_b: FloatArray) -> dict[str, float]:
    """The worse of both directions."""
    one, other = meeting(a, b, T_a_b), meeting(b, a, se3.inverse(T_a_b))
    worse = {"overlap": min, "through": max, "agreement": min, "seen": min}
    return {name: choose(one[name], other[name]) for name, choose in worse.items()}


def soundness(evidence: dict[str, Any]) -> float:
    """Class agreement, and much less where points stand in what the other view saw through."""
    return float(evidence["agreement"] * (1.0 - evidence["through"]) ** SEEN_THROUGH_POWER)


def features_suffice(evidence: dict[str, Any], settings: RegistrationSettings) -> bool:
    """Whether features alone know the pose, in all directions, and chance did not make them agree."""
    return bool(
        evidence.get("chance_log10", 0.0) <= settings.max_chance_log10
        and evidence["feature_sigma_m"] <= settings.max_feature_sigma_m
        and evidence["feature_sigma_deg"] <= settings.max_feature_sigma_deg
    )


def refusal(evidence: dict[str, Any], settings: RegistrationSettings, has_prior: bool) -> str:
    """Why the pose is not believed; empty where it is."""
    many = evidence["inliers"] >= settings.many_matches
    overlap, through, agreement = evidence["overlap"], evidence["through"], evidence["agreement"]
    few_points = settings.min_overlap_features if many else settings.min_overlap
    if features_suffice(evidence, settings):
        few_points = settings.min_overlap_alone
    least = settings.min_soundness if has_prior else settings.min_soundness_alone
    checks = (
        (overlap < few_points, f"the views share {overlap:.0%} of their points"),
        (through > settings.max_seen_through, f"{through:.0%} stand where the other view saw through"),
        (agreement < settings.min_class_agreement, f"classes agree for {agreement:.0%} of the points"),
        (soundness(evidence) < least, f"{through:.1%} are seen through and classes agree for {agreement:.0%} only"),
        (not many and evidence["score"] < settings.min_score, f"surfaces fit badly (score {evidence['score']:.2f})"),
        (evidence["sigma_m"] > settings.max_sigma_m, f"it slides: one direction is known to {evidence['sigma_m']:.1f} m only"),
    )
    return next((words for refused, words in checks if refused), "")
