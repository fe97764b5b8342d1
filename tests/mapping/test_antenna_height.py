"""The height of an antenna that nobody measured, beside a roll that nobody knows."""

import numpy as np
import pytest

from wayloom.evaluation.gnss_drives import LEVER_M, Receiver, city_way, made_drive
from wayloom.georeference.alignment import georeference
from wayloom.mapping.antenna_height import DOWN, antenna_height, held_at, is_loose, without_height
from wayloom.mapping.drive_equations import CorrelatedFixes, DriveEquations
from wayloom.mapping.drive_types import AntennaFixes, DriveNoise, OdometryChain
from wayloom.mapping.odometry_links import links_of

NOISE = DriveNoise(0.005, 3e-4, 0.002, 1e-4, 0.02, 100.0, 0.05, 30.0, 0.02, 0.9999, 1e-3, 1.5)
COUNT = 40


def straight() -> OdometryChain:
    T = np.tile(np.eye(4), (COUNT, 1, 1))
    T[:, :3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    T[:, 1, 3] = np.arange(COUNT)
    return OdometryChain(T, np.ones(COUNT - 1), np.ones(COUNT - 1, bool), np.array([COUNT // 2]))


def equations(antenna_m: np.ndarray, noise: DriveNoise = NOISE, noise_m: float = 0.0) -> tuple[DriveEquations, np.ndarray]:
    """Of a straight drive with an antenna at antenna_m (3,) that its fixes are made without."""
    chain = straight()
    error = noise_m * np.random.default_rng(0).normal(size=(COUNT, 3))
    place = chain.T_world_node[:, :3, :3] @ antenna_m + chain.T_world_node[:, :3, 3] + error
    eye = np.tile(np.eye(3), (COUNT, 1, 1))
    fixes = AntennaFixes(
        np.arange(COUNT) * 0.1, np.arange(COUNT), np.zeros(COUNT), np.zeros((COUNT, 3)), np.tile([0.0, 0.0, 10.0], (COUNT, 1)),
        eye, place, eye * 0.02**2, np.full(COUNT, 3, np.uint8), np.full(COUNT, 0.5),
    )  # fmt: skip
    return DriveEquations(chain, links_of(chain, noise), CorrelatedFixes(fixes, noise), noise), chain.T_world_node


def test_a_lever_arm_that_is_given_is_no_matter_of_roll() -> None:
    given = DriveNoise(0.005, 3e-4, 0.002, 1e-4, 0.02, 100.0, 0.05, 30.0, 0.02, 0.9999, 1e-3, 0.002)
    assert is_loose(equations(np.zeros(3))[0])
    assert not is_loose(equations(np.zeros(3), given)[0])


def test_an_antenna_that_is_held_lower_leaves_the_other_unknowns_free() -> None:
    both, T = equations(np.array([0.0, -1.0, 0.0]))
    held = held_at(both, -1.0)
    state = held.descend(held.first_state(T))
    assert np.abs(state.receiver).max() < 1e-3
    assert np.abs(state.T_enu_node - T).max() < 1e-4


def test_a_straight_road_says_nothing_of_the_height() -> None:
    both, T = equations(np.array([0.0, -1.0, 0.0]), noise_m=0.02)
    height = antenna_height(both, both.descend(both.first_state(T)))
    assert abs(height.down_m) < NOISE.lever_m
    assert height.sigma_m > 0.8 * NOISE.lever_m


def test_the_camera_sinks_by_as_much_as_the_antenna_is_higher() -> None:
    both, T = equations(np.zeros(3))
    height = antenna_height(both, both.descend(both.first_state(T)))
    place_per_m = height.nodes_per_m[:, :3] + np.cross(height.nodes_per_m[:, 3:], T[:, :3, 3])
    assert place_per_m[:, 2] == pytest.approx(1.0, abs=1e-3)  # a metre further down in the camera: the camera is a metre higher
    assert height.receiver_per_m[DOWN] == 1.0


def test_without_its_height_the_receiver_keeps_the_rest() -> None:
    assert without_height(np.array([1.0, 2.0, 3.0, 4.0])).tolist() == [1.0, 2.0, 0.0, 4.0]


@pytest.mark.parametrize("seed", [1, 15])
def test_a_height_that_nobody_gave_does_not_run_away_with_the_roll(seed: int) -> None:
    """The joint maximum over height and roll put these antennas 2.8 and 1.8 m too high, at a sigma of 0.8 m."""
    drive = made_drive(city_way(60.0), Receiver(lever_given=False), seed)
    report = georeference(drive.log, drive.odometry).report  # type: ignore[arg-type]
    error = np.array(report["lever_correction_m"]) - LEVER_M
    assert (np.abs(error) < 3.0 * np.array(report["sigma_lever_m"])).all()
    assert abs(error[1]) < 1.5
