import numpy as np
import pytest
from made_street import MadeLog, curve

from wayloom.geometry import se3
from wayloom.georeference.nodes import link_covariances
from wayloom.odometry.backend import steps
from wayloom.odometry.backend.window import Window, add_keyframe, empty_window
from wayloom.odometry.odometry import track
from wayloom.odometry.types import Keyframes


@pytest.fixture
def window() -> Window:
    """Three keyframes of which the information of a relative pose, and of nothing else, ties each to the one before."""
    out, rng = empty_window((16, 16), 4, 0.0, 1.0), np.random.default_rng(2)
    image = np.zeros((16, 16), np.uint8)
    for row in (4, 5, 7):
        add_keyframe(out, image, image, se3.exp(0.3 * rng.normal(size=6)), np.zeros(2), row)
    out.H = np.diag(np.tile(np.concatenate([np.zeros(6), np.ones(2)]), 4))[7:, 7:] + np.diag([1.0, *np.zeros(24)])
    return out


def tie(window: Window, f: int, information: np.ndarray) -> None:
    """Add that the step from frame f - 1 to f is known by information (6, 6) of its left perturbation."""
    T = window.frames.T_cam_world
    J = np.zeros((6, 25))
    J[:, 1 + 8 * (f - 1) : 7 + 8 * (f - 1)] = np.eye(6)
    J[:, 1 + 8 * f : 7 + 8 * f] = -se3.adjoint(T[f - 1] @ se3.inverse(T[f]))
    window.H += J.T @ information @ J


def test_a_steps_covariance_is_that_of_its_only_measurement(window: Window) -> None:
    root = np.random.default_rng(3).normal(size=(6, 6))
    information = root @ root.T + np.eye(6)
    tie(window, 1, 7.0 * np.eye(6))
    tie(window, 2, information)
    np.testing.assert_allclose(steps.step_covariance(window, 2.0), 4.0 * np.linalg.inv(information), rtol=1e-9, atol=1e-12)


def test_a_step_that_nothing_ties_is_not_known(window: Window) -> None:
    tie(window, 1, np.eye(6))
    assert np.isnan(steps.step_covariance(window, 2.0)).all()


def test_steps_of_a_drive_are_known_but_the_first() -> None:
    covariance = track(MadeLog(curve(8))).keyframes.step_covariance
    assert np.isnan(covariance[0]).all()
    assert (np.linalg.eigvalsh(covariance[1:].astype(np.float64)) > 0).all()


def test_links_between_nodes_share_the_steps_between_keyframes() -> None:
    covariance = np.eye(6, dtype=np.float32) * np.array([np.nan, 4.0, 8.0], np.float32)[:, None, None]
    T, none = np.tile(np.eye(4), (3, 1, 1)), np.zeros(3, np.int32)
    keyframes = Keyframes(np.array([0, 4, 8], np.int32), T, np.zeros((3, 4)), none, covariance)
    nodes = np.array([0, 1, 4, 8, 9])
    found = link_covariances(keyframes, nodes, np.zeros(5, np.int32))
    np.testing.assert_allclose(found[:, 0, 0], [1.0, 3.0, 8.0, 2.0])
    assert not link_covariances(keyframes, nodes, np.ones(5, np.int32)).any()


def test_dark_frames_widen_the_steps_to_them_and_to_no_other() -> None:
    def darkened(left: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (left * 0.12).astype(np.uint8), (right * 0.12).astype(np.uint8)

    light = track(MadeLog(curve(24))).keyframes
    dark = track(MadeLog(curve(24), changes=dict.fromkeys(range(10, 16), darkened))).keyframes
    before, usual = dark.frame < 10, np.nanmedian(sigmas(light))
    assert (sigmas(dark)[~before & (dark.frame < 16)] > 2.0 * usual).all()
    assert (sigmas(dark)[dark.frame > 17] < 1.5 * usual).all()
    np.testing.assert_array_equal(dark.step_covariance[before], light.step_covariance[light.frame < 10])


def sigmas(keyframes: Keyframes) -> np.ndarray:
    """(K,) the largest sigma of each step, m or rad."""
    return np.sqrt(np.diagonal(keyframes.step_covariance, axis1=1, axis2=2)).max(axis=1)
