"""Objects of a made street: where they stand, by how much the covariance says, and what is none."""

from dataclasses import replace

import numpy as np
import pytest

from objects.made_furniture import FRONT_X_M, POLE_AT, SIGN_AT, SIGN_M, STRIPE_Y_M, TRUNK_AT, FurnishedStreet
from wayloom.config.classes import CLASS_ID
from wayloom.geometry import se3
from wayloom.objects.evidence import Facts, unseen_views
from wayloom.objects.fusion import fuse
from wayloom.objects.making import find_objects, measure, read_views, tracks_with_facts
from wayloom.objects.odds import odds_of
from wayloom.objects.settings import ObjectFusionSettings, ObjectSettings
from wayloom.objects.tracks import Track, tracks_of
from wayloom.objects.triangulation import cameras_of, first_points
from wayloom.objects.types import POLE, TRUNK, MapObject, PlacedSightings


@pytest.fixture(scope="module")
def street() -> FurnishedStreet:
    return FurnishedStreet(count=12, step_m=1.0)


@pytest.fixture(scope="module")
def found(street: FurnishedStreet) -> list[MapObject]:
    """Everything that the street's drive finds, the doubtful too."""
    submaps = street.submaps(1)
    sightings = list(find_objects(street, street.odometry(), street, submaps, lambda submap: None))
    placed = [PlacedSightings(one, at.T_enu_submap, at.covariance, "drive") for one, at in zip(sightings, submaps, strict=True)]
    return fuse(placed, ObjectFusionSettings(least_confidence=0.0))


def near(found: list[MapObject], kind: str, place: np.ndarray, within: float = 0.5) -> list[MapObject]:
    axes = 2 if kind in ("pole", "trunk") else 3
    return [one for one in found if one.kind == kind and np.linalg.norm((one.position - place)[:axes]) < within]


@pytest.mark.parametrize(("kind", "place"), [("pole", POLE_AT), ("trunk", TRUNK_AT), ("traffic_sign", SIGN_AT)])
def test_a_thing_is_found_once_where_it_stands_as_well_as_its_covariance_says(
    found: list[MapObject], kind: str, place: np.ndarray
) -> None:
    (one,) = near(found, kind, place)
    assert one.confidence > 0.8
    off = (one.position - place)[:2]
    assert np.hypot(*off) < 0.08
    assert off @ np.linalg.solve(one.covariance[:2, :2], off) < 3.0**2
    assert np.sqrt(one.covariance[0, 0]) < 0.08


def test_a_sign_has_its_size_and_faces_the_drive(found: list[MapObject]) -> None:
    (sign,) = near(found, "traffic_sign", SIGN_AT)
    assert sign.width_m == pytest.approx(SIGN_M, abs=0.1)
    assert sign.height_m - sign.bottom_m == pytest.approx(SIGN_M, abs=0.12)
    assert sign.facing_rad is not None
    assert sign.facing_sigma_rad is not None
    assert abs(np.degrees(sign.facing_rad) - 180.0) < 15.0


def test_a_sign_whose_post_stands_before_it_faces_away_from_the_drive() -> None:
    street = FurnishedStreet(count=12, step_m=1.0, from_behind=True)
    (sightings,) = find_objects(street, street.odometry(), street, street.submaps(1), lambda submap: None)
    placed = PlacedSightings(sightings, street.submaps(1)[0].T_enu_submap, np.zeros((6, 6)), "drive")
    (sign,) = near(fuse([placed], ObjectFusionSettings(least_confidence=0.0)), "traffic_sign", SIGN_AT)
    assert sign.facing_rad is not None
    assert np.cos(sign.facing_rad) > 0.0  # to the north, as the drive goes; of a dull back the slope is no better known


def test_the_post_under_a_sign_is_an_object_of_its_own(found: list[MapObject]) -> None:
    assert len(near(found, "pole", SIGN_AT, 0.3)) == 1


def test_a_stripe_on_a_front_is_refused(found: list[MapObject]) -> None:
    stripe = near(found, "pole", np.array([FRONT_X_M, STRIPE_Y_M, 0.0]), 1.0)
    assert len(stripe) > 0
    assert max(one.confidence for one in stripe) < 0.3


def test_nothing_else_is_believed(found: list[MapObject]) -> None:
    assert sum(one.confidence > ObjectFusionSettings().least_confidence for one in found) == 4


def test_a_post_that_carries_a_sign_is_surer_than_one_of_the_same_looks(street: FurnishedStreet) -> None:
    (placed,) = street.submaps(1)
    views = read_views(street, street.odometry(), street, placed, np.ones(street.count, bool))
    things = tracks_with_facts(views, None, ObjectSettings())
    posts = [facts for track, facts, *_ in things if track.kind == POLE and facts.carries]
    assert len(posts) == 1
    bare = replace(posts[0], carries=False)
    (carrying, against), (plain, still_against) = odds_of(POLE, posts[0]), odds_of(POLE, bare)
    assert carrying > plain
    assert against == still_against


def test_what_a_stub_of_pole_goes_on_as_makes_it_doubtful() -> None:
    pole = Facts(6, 0, 0, 0.4, 0.2, 8.0, 1.0, 0.0, carries=False, goes_on=0.0)
    of_trunk, tall = replace(pole, goes_on=1.0), replace(pole, goes_on=1.0, height=4.0)
    net = [np.subtract(*odds_of(POLE, one)) for one in (pole, tall, of_trunk)]
    assert net[0] > net[1] > net[2]


def test_stereo_sees_what_goes_on_above_a_label() -> None:
    class HalfLabelled(FurnishedStreet):
        def images(self, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            left, right, label = super().images(index)
            upper = np.arange(label.shape[0])[:, None] < label.shape[0] // 2
            return left, right, np.where(upper & (label == CLASS_ID["pole"]), CLASS_ID["building"], label).astype(np.uint8)

    def goes_on(street: FurnishedStreet) -> float:
        (placed,) = street.submaps(1)
        views = read_views(street, street.odometry(), street, placed, np.ones(street.count, bool))
        found = measure(views, ObjectSettings())
        T = se3.inverse(placed.T_enu_submap)
        place = placed.T_enu_submap[:3, :3] @ (T[:3, :3] @ POLE_AT + T[:3, 3])
        own = (found.kind == POLE) & (np.linalg.norm(first_points(cameras_of(views), found)[:, :2] - place[:2], axis=1) < 0.5)
        return float(np.nanmean(found.goes_on[own]))

    assert goes_on(FurnishedStreet(count=12, step_m=1.0, pole_tall_m=1.2)) < 0.3
    assert goes_on(HalfLabelled(count=12, step_m=1.0)) > 0.7


def test_views_see_through_what_is_not_there_and_not_through_what_is(street: FurnishedStreet) -> None:
    (placed,) = street.submaps(1)
    views = read_views(street, street.odometry(), street, placed, np.ones(street.count, bool))
    seen, cameras = measure(views, ObjectSettings()), cameras_of(views)
    poles = [one for one in tracks_of(seen, cameras, 3) if one.kind == POLE]
    T = se3.inverse(placed.T_enu_submap)
    R = placed.T_enu_submap[:3, :3]
    place = R @ (T[:3, :3] @ POLE_AT + T[:3, 3])  # level frame
    real = min(poles, key=lambda one: float(np.linalg.norm((one.place - place)[:2])))
    few = Track(POLE, real.rows[:1], real.place, real.covariance)
    ghost = Track(POLE, real.rows[:3], real.place + np.array([-1.3, 0.0, 0.0]), real.covariance)
    same, through = unseen_views(few, seen, views, cameras, 22.0)
    assert same >= 2
    assert through == 0
    same, through = unseen_views(ghost, seen, views, cameras, 22.0)
    assert through >= 3
    assert same == 0


def test_a_drive_tells_where_it_looked(street: FurnishedStreet) -> None:
    submaps = street.submaps(1)
    (one,) = find_objects(street, street.odometry(), street, submaps, lambda submap: None)
    T = se3.inverse(submaps[0].T_enu_submap)
    before, behind_front, behind_start = one.looked_at(
        se3.transform(T, np.array([[0.0, 14.0, 1.0], [FRONT_X_M + 3.0, 10.0, 1.0], [0.0, -8.0, 1.0]]))
    )
    assert before >= 4
    assert behind_front == 0
    assert behind_start == 0


def test_a_street_without_things_has_none() -> None:
    from made_ground import MadeStreet

    street = MadeStreet(count=6)
    (one,) = find_objects(street, street.odometry(), street, street.submaps(1), lambda submap: None)
    assert len(one) == 0
    assert TRUNK not in one.kind
