"""Bend of submaps by the drive's graph, as far as it is more than the graph's own noise."""

import dataclasses

import numpy as np
import pytest

from submaps.made_submaps import made_geo, made_odometry
from wayloom.geometry import se3
from wayloom.georeference.types import Anchors
from wayloom.submaps.bend import DRIFT_SHARE, noticed, stretches2


def test_bends_are_shrunk_as_a_slow_twin_shrinks_them() -> None:
    rng = np.random.default_rng(0)
    bend, T = rng.normal(size=(20, 6)) * 0.1, se3.exp(rng.normal(size=(20, 6)) * 5.0)
    found = noticed(bend, T, 0.01**2)
    for own, T_one, shrunk in zip(bend, T, found, strict=True):
        moved = np.linalg.norm(own[:3] + np.cross(own[3:], T_one[:3, 3]))
        d = np.linalg.norm(T_one[:3, 3])
        o2 = max(moved**2 - (0.01 * d) ** 2, 0.0) + (DRIFT_SHARE * d) ** 2
        np.testing.assert_allclose(shrunk, own * np.sqrt(o2 / (o2 + (0.01 * d) ** 2)), rtol=1e-12)


def ahead(bend_m: float, at_m: float, stretch: float) -> float:
    """What is told of a keyframe at_m ahead of the anchor that the graph has bend_m further ahead."""
    T = np.eye(4)
    T[2, 3] = at_m
    return float(noticed(np.array([[0.0, 0.0, bend_m, 0.0, 0.0, 0.0]]), T[None], stretch**2)[0, 2])


def test_a_break_is_told_and_what_fixes_pull_within_their_noise_is_not() -> None:
    assert ahead(1.5, 30.0, 0.01) > 1.4
    assert ahead(0.2, 30.0, 0.01) < 0.3 * 0.2
    assert ahead(0.2, 30.0, 0.0) == 0.2
    assert ahead(0.1, 0.0, 0.01) == pytest.approx(0.1)


def test_the_graphs_noise_is_that_of_its_steps_to_the_neighbours() -> None:
    """Poses whose errors are a walk: a step of 60 m has the sum of two variances less twice what they share."""
    odometry = made_odometry(200.0)
    anchors = np.array([30, 90, 150])
    geo = made_geo(odometry)
    at = se3.adjoint(se3.from_rotation_translation(np.tile(np.eye(3), (3, 1, 1)), geo.T_enu_cam[anchors, :3, 3]))
    walk = [np.diag([v] * 3 + [1e-9] * 3) for v in (0.01, 0.05, 0.14)]
    P = np.array([Ad @ own @ Ad.T for Ad, own in zip(at, walk, strict=True)])
    covariance = geo.covariance.copy()
    covariance[anchors] = P
    cross = P[:-1]
    geo = dataclasses.replace(geo, covariance=covariance, anchors=Anchors(anchors, cross, np.array([True, True])))
    expected = 3.0 * np.array([0.04, (0.04 + 0.09) / 2.0, 0.09]) / 60.0**2
    np.testing.assert_allclose(stretches2(geo, anchors), expected, rtol=0.02)
    lost = dataclasses.replace(geo, anchors=dataclasses.replace(geo.anchors, connected=np.array([True, False])))
    np.testing.assert_allclose(stretches2(lost, anchors), 3.0 * np.array([0.04, 0.04, 0.0]) / 60.0**2, rtol=0.02)
    assert not stretches2(geo, anchors + 2).any()
