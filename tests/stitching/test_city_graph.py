"""The city graph: chains of drives, false meetings, drives without GNSS, regions, order of arrival, faults."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.evaluation.made_fleets import MadeFleet, made_fleet
from wayloom.geometry import se3
from wayloom.stitching.city_equations import city_equations
from wayloom.stitching.city_graph import CityMemory, canonical, optimise_city
from wayloom.stitching.drive_chain import across, drive_chain
from wayloom.stitching.settings import CityGraphSettings
from wayloom.stitching.types import City, DrivePlaces

FloatArray = NDArray[np.float64]
SETTINGS = CityGraphSettings()
BY_CELLS = CityGraphSettings(whole_up_to=1)


@pytest.fixture(scope="module")
def fleet() -> MadeFleet:
    return made_fleet(20, seed=3)


@pytest.fixture(scope="module")
def city(fleet: MadeFleet) -> City:
    return optimise_city(fleet.drives, fleet.meetings)


def about_itself(T: FloatArray, covariance: FloatArray) -> FloatArray:
    """Covariances (n, 6, 6) of left perturbations about the places of T (n, 4, 4)."""
    Ad = se3.adjoint(se3.from_rotation_translation(np.tile(np.eye(3), (len(T), 1, 1)), -T[:, :3, 3]))
    return np.asarray(Ad @ covariance @ np.swapaxes(Ad, 1, 2))


def one_drive(kind: str, with_cross: bool = False) -> DrivePlaces:
    fleet = made_fleet(10, seed=5, submaps=8, with_cross=with_cross)
    return next(drive for drive in fleet.drives if fleet.kind[drive.drive_id] == kind)


@pytest.mark.parametrize("kind", ["RTK", "float", "single"])
@pytest.mark.parametrize("with_cross", [False, True])
def test_a_drive_that_meets_none_stays_where_and_as_sure_as_it_was(kind: str, with_cross: bool) -> None:
    drive = one_drive(kind, with_cross)
    placed = optimise_city([drive], []).drives[drive.drive_id]
    np.testing.assert_allclose(placed.T_map_submap, drive.T_map_submap, atol=1e-9)
    expected = about_itself(drive.T_map_submap, drive.covariance)
    np.testing.assert_allclose(about_itself(drive.T_map_submap, placed.covariance), expected, atol=1e-6 * expected.max())


def test_the_chain_has_the_covariances_of_neighbours_that_the_drive_tells() -> None:
    drive = one_drive("single", with_cross=True)
    assert drive.cross is not None
    chain = drive_chain(drive, SETTINGS)
    right = se3.adjoint(se3.inverse(drive.T_map_submap))
    for k in range(len(drive) - 1):
        P = right[k] @ drive.covariance[k] @ right[k].T
        np.testing.assert_allclose(P @ chain.ahead[k + 1].T, right[k] @ drive.cross[k] @ right[k + 1].T, atol=1e-8)


def test_where_a_drive_does_not_tell_how_neighbours_are_joined_it_is_derived() -> None:
    told, derived = one_drive("single", with_cross=True), one_drive("single")
    assert told.cross is not None
    partly = replace(told, cross=np.where(np.arange(len(told.cross))[:, None, None] == 2, np.nan, told.cross))
    steps = [drive_chain(drive, SETTINGS).step for drive in (partly, told, derived)]
    own = np.arange(len(told)) != 3
    np.testing.assert_array_equal(steps[0][own], steps[1][own])
    np.testing.assert_array_equal(steps[0][3], steps[2][3])


def test_a_derived_chain_lets_neighbours_differ_by_the_odometry_where_gnss_knows_less() -> None:
    drive = one_drive("single")
    sigma = np.sqrt(np.diagonal(drive_chain(drive, SETTINGS).step[1:], axis1=1, axis2=2))
    L, turn = 75.0, np.radians(SETTINGS.rotation_noise_deg) * np.sqrt(75.0)
    place = np.sqrt(SETTINGS.position_noise_m**2 * L + (turn * L) ** 2 / 12.0 + (SETTINGS.scale_sigma * L) ** 2)
    # seen from the one submap, half a submap's length from the middle, a turn moves the other
    np.testing.assert_allclose(sigma[:, 3:], turn, rtol=0.05)
    assert (sigma[:, :3] > 0.95 * place).all()
    assert (sigma[:, :3] < 1.05 * np.hypot(place, turn * L)).all()


def test_what_lies_between_two_submaps_is_integrated_out() -> None:
    chain = drive_chain(one_drive("float"), SETTINGS)
    A, information = across(chain, 2, 5)
    P = [np.linalg.inv(one) for one in chain.alone]
    np.testing.assert_allclose(A @ P[2] @ A.T + np.linalg.inv(information), P[5], atol=1e-9)
    np.testing.assert_allclose(A, chain.ahead[5] @ chain.ahead[4] @ chain.ahead[3])


def test_gradient_and_matrix_are_those_of_numeric_differentiation() -> None:
    fleet = made_fleet(3, seed=1, submaps=3, side=3)
    rng = np.random.default_rng(1)
    chains = [drive_chain(drive, SETTINGS) for drive in fleet.drives]
    ends = np.array([[0, 4], [2, 7]])
    T0 = np.concatenate([chain.T0 for chain in chains])
    equations = city_equations(
        np.array([-1, 0, 1, -1, 3, 4, -1, 6, 7]),
        T0,
        np.concatenate([chain.ahead for chain in chains]),
        np.concatenate([chain.information for chain in chains]),
        ends,
        se3.exp(0.05 * rng.normal(size=(2, 6))) @ se3.inverse(T0[ends[:, 0]]) @ T0[ends[:, 1]],
        np.tile(np.diag([0.01] * 3 + [1e-4] * 3), (2, 1, 1)),
    )
    state, weight = equations.moved(equations.T0, 0.02 * rng.normal(size=(10, 6))), np.ones(11)
    state[-1] = np.eye(4)

    def errors(step: FloatArray) -> FloatArray:
        return equations.errors(equations.moved(state, np.concatenate([step.reshape(9, 6), np.zeros((1, 6))]))).ravel()

    h = 1e-6
    J = np.stack([(errors(h * e) - errors(-h * e)) / (2.0 * h) for e in np.eye(54)], axis=1)
    omega = np.zeros((66, 66))
    for k in range(11):
        omega[6 * k : 6 * k + 6, 6 * k : 6 * k + 6] = equations.information[k]
    diagonal, blocks, gradient = equations.normal(state, equations.errors(state), weight)
    expected, H = J.T @ omega @ equations.errors(state).ravel(), J.T @ omega @ J
    np.testing.assert_allclose(gradient[:9].ravel(), expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())
    for k in range(9):
        block = H[6 * k : 6 * k + 6, 6 * k : 6 * k + 6]
        np.testing.assert_allclose(diagonal[k], block, rtol=1e-4, atol=1e-6 * np.abs(block).max())
    i, j, slot = equations.first[1], equations.second[1], equations.slot[1]
    np.testing.assert_allclose(
        blocks[slot], H[6 * i : 6 * i + 6, 6 * j : 6 * j + 6], rtol=1e-4, atol=1e-6 * np.abs(H[:6, 6:12]).max()
    )


def test_no_false_meeting_is_used_and_hardly_a_right_one_refused(fleet: MadeFleet, city: City) -> None:
    false = {canonical(meeting) for meeting, mark in zip(fleet.meetings, fleet.false, strict=True) if mark}
    wrong = [one for one in city.meetings if canonical(one.meeting) in false]
    assert len(wrong) == fleet.false.sum() > 20
    assert all(one.refused for one in wrong)
    assert sum(bool(one.refused) for one in city.meetings) - len(wrong) <= 0.01 * len(city.meetings)


def test_single_point_drives_lie_within_two_decimetres_where_they_meet_rtk_ones(fleet: MadeFleet, city: City) -> None:
    met = {
        (one, k)
        for meeting, mark in zip(fleet.meetings, fleet.false, strict=True)
        for one, k, other in (
            (meeting.drive_a, meeting.submap_a, meeting.drive_b),
            (meeting.drive_b, meeting.submap_b, meeting.drive_a),
        )
        if not mark and fleet.kind[one] == "single" and fleet.kind[other] == "RTK"
    }
    off = np.array([np.linalg.norm((city.drives[name].T_map_submap[k] - fleet.truth[name][k])[:3, 3]) for name, k in met])
    before = {drive.drive_id: drive.T_map_submap for drive in fleet.drives}
    was = np.array([np.linalg.norm((before[name][k] - fleet.truth[name][k])[:3, 3]) for name, k in met])
    assert len(off) > 10
    assert np.sqrt((was**2).mean()) > 1.0
    assert np.sqrt((off**2).mean()) < 0.2


def test_errors_are_as_large_as_their_covariances_say() -> None:
    means = []
    for seed in range(8):
        fleet = made_fleet(12, seed=100 + seed)
        nees = []
        for drive in optimise_city(fleet.drives, fleet.meetings).drives.values():
            true = fleet.truth[drive.drive_id]
            xi = np.array([se3.log(T) for T in drive.T_map_submap @ se3.inverse(true)])
            nees += [x @ np.linalg.solve(C, x) for x, C in zip(xi, drive.covariance, strict=True)]
        means.append(np.mean(nees) / 6.0)
    # submaps of a fleet err together, so that each fleet is one draw; RTK's neighbours are taken for independent
    assert 0.7 < np.mean(means) < 1.2


def test_a_drive_without_gnss_is_placed_by_meetings_that_agree_and_not_by_one(fleet: MadeFleet, city: City) -> None:
    loose = next(name for name, kind in fleet.kind.items() if kind == "none")
    assert all(drive.placed for drive in city.drives.values())
    own = [m for m, mark in zip(fleet.meetings, fleet.false, strict=True) if loose in (m.drive_a, m.drive_b) and not mark]
    rest = [m for m in fleet.meetings if loose not in (m.drive_a, m.drive_b)]
    alone = optimise_city(fleet.drives, [*rest, own[0]])
    assert not alone.drives[loose].placed
    assert [one.refused for one in alone.meetings if one.meeting is own[0]] == [
        "a drive that it joins has no GNSS, and its meetings do not agree on a place"
    ]


@pytest.mark.parametrize("settings", [SETTINGS, BY_CELLS])
def test_any_order_of_arrival_gives_the_same_bits(fleet: MadeFleet, settings: CityGraphSettings) -> None:
    rng, memory = np.random.default_rng(1), CityMemory()
    once = optimise_city(fleet.drives, fleet.meetings, settings)
    known: list[DrivePlaces] = []
    for k in rng.permutation(len(fleet.drives)).tolist():
        known.append(fleet.drives[k])
        names = {drive.drive_id for drive in known}
        if len(known) % 5 == 0:
            heard = [fleet.meetings[m] for m in rng.permutation(len(fleet.meetings)).tolist()]
            heard = [one for one in heard if one.drive_a in names and one.drive_b in names]
            grown = optimise_city(known, heard, settings, memory)
    for name, drive in once.drives.items():
        assert np.array_equal(drive.T_map_submap, grown.drives[name].T_map_submap)
        assert np.array_equal(drive.covariance, grown.drives[name].covariance)
    assert [one.refused for one in once.meetings] == [one.refused for one in grown.meetings]


def test_cells_with_their_surroundings_agree_with_the_whole_within_a_small_part_of_a_sigma() -> None:
    fleet = made_fleet(40, seed=7)
    whole = optimise_city(fleet.drives, fleet.meetings, CityGraphSettings(whole_up_to=10**6))
    cells = optimise_city(fleet.drives, fleet.meetings, BY_CELLS)
    assert cells.windows > 5
    off = []
    for name, drive in whole.drives.items():
        if drive.placed:
            variance = np.trace(about_itself(drive.T_map_submap, drive.covariance)[:, :3, :3], axis1=1, axis2=2)
            moved = np.linalg.norm((drive.T_map_submap - cells.drives[name].T_map_submap)[:, :3, 3], axis=1)
            off += (moved / np.sqrt(variance)).tolist()
    assert np.quantile(off, 0.95) < 0.03
    assert max(off) < 0.15
    assert [one.refused == "" for one in whole.meetings] == [one.refused == "" for one in cells.meetings]


def test_a_drive_that_comes_changes_only_the_cells_near_it() -> None:
    fleet, memory = made_fleet(40, seed=8, side=16), CityMemory()
    last = fleet.drives[-1].drive_id
    before = [m for m in fleet.meetings if last not in (m.drive_a, m.drive_b)]
    optimise_city(fleet.drives[:-1], before, BY_CELLS, memory)
    grown = optimise_city(fleet.drives, fleet.meetings, BY_CELLS, memory)
    assert 0 < grown.solved < grown.windows
    assert optimise_city(fleet.drives, fleet.meetings, BY_CELLS, memory).solved == 0


def test_faults_name_the_drive_or_the_meeting(fleet: MadeFleet) -> None:
    with pytest.raises(InputError, match="drive-0000 comes twice"):
        optimise_city([*fleet.drives, fleet.drives[0]], [])
    with pytest.raises(InputError, match="names submap 99 of drive drive-0001, which has 20"):
        optimise_city(fleet.drives, [replace(fleet.meetings[0], drive_a="drive-0001", submap_a=99)])
    with pytest.raises(InputError, match="no pose or no covariance"):
        optimise_city(fleet.drives, [replace(fleet.meetings[0], covariance=np.zeros((6, 6)))])
    bad = fleet.drives[0].covariance.copy()
    bad[3] = -bad[3]
    with pytest.raises(InputError, match=r"drive-0000 .*not positive definite"):
        optimise_city([replace(fleet.drives[0], covariance=bad)], [])


def test_far_from_the_maps_origin_places_and_covariances_are_the_same(fleet: MadeFleet, city: City) -> None:
    far = se3.from_rotation_translation(np.eye(3), np.array([-8000.0, 55_000.0, -130.0]))
    Ad = se3.adjoint(far)
    moved = [
        replace(drive, T_map_submap=far @ drive.T_map_submap, covariance=Ad @ drive.covariance @ Ad.T) if drive.located else drive
        for drive in fleet.drives
    ]
    there = optimise_city(moved, fleet.meetings)
    for name, drive in city.drives.items():
        T = there.drives[name].T_map_submap
        np.testing.assert_allclose(T, far @ drive.T_map_submap, atol=1e-4)
        sigma2 = np.diagonal(about_itself(drive.T_map_submap, drive.covariance), axis1=1, axis2=2)
        np.testing.assert_allclose(np.diagonal(about_itself(T, there.drives[name].covariance), axis1=1, axis2=2), sigma2, rtol=1e-2)
