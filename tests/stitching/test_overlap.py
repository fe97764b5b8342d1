"""Grid look-up of drives that may overlap."""

import numpy as np

from stitching.made_placed_drives import FRAME, placed_submap
from wayloom.geometry import se3
from wayloom.stitching.overlap import CELL_M, SEEN_M, box_of, cells_of, pairs_of_drives
from wayloom.submaps.submap import PlacedSubmap


def submap_at(east_m: float, sigma_m: float = 0.1, located: bool = True) -> PlacedSubmap:
    """Cameras along ten metres to the north."""
    T = np.tile(np.eye(4), (6, 1, 1))
    T[:, :3, 3] = np.column_stack([np.full(6, east_m), np.arange(0.0, 12.0, 2.0), np.zeros(6)])
    covariance = np.diag([sigma_m**2] * 3 + [0.0] * 3) if located else np.full((6, 6), np.nan)
    return placed_submap("a", T, T, np.arange(6), covariance, located)


def test_the_box_holds_the_surroundings_and_three_sigmas() -> None:
    low, high = box_of(submap_at(500.0, 2.0))
    np.testing.assert_allclose(low, [500.0 - SEEN_M - 6.0, -SEEN_M - 6.0])
    np.testing.assert_allclose(high, [500.0 + SEEN_M + 6.0, 10.0 + SEEN_M + 6.0])


def test_an_uncertain_heading_widens_the_box_about_the_submap_not_about_the_origin() -> None:
    item = submap_at(5000.0)
    shift = np.eye(4)
    shift[:3, 3] = item.track_enu().mean(axis=0)
    Ad = se3.adjoint(shift)
    turned = PlacedSubmap(item.submap, item.T_enu_submap, Ad @ np.diag([0.01, 0.01, 0.01, 0, 0, 0.01]) @ Ad.T, item.drive_id, FRAME)
    low, high = box_of(turned)
    np.testing.assert_allclose(high - low, [2 * (SEEN_M + 0.3), 10.0 + 2 * (SEEN_M + 0.3)], rtol=1e-6)


def test_drives_near_each_other_are_a_pair_and_others_are_not() -> None:
    cells = {name: cells_of([submap_at(east)]) for name, east in (("c", 0.0), ("a", 30.0), ("b", 20 * CELL_M))}
    assert pairs_of_drives(cells) == [("a", "c")]


def test_a_drive_that_may_be_anywhere_near_is_a_pair_with_its_neighbours() -> None:
    cells = {"a": cells_of([submap_at(0.0)]), "b": cells_of([submap_at(3 * CELL_M, sigma_m=CELL_M)])}
    assert pairs_of_drives(cells) == [("a", "b")]


def test_a_drive_without_a_place_has_no_cells() -> None:
    assert cells_of([submap_at(0.0, located=False)]) == frozenset()
