"""Upright things of a place are single, in their place, and the same for who comes the other way."""

from dataclasses import replace

import numpy as np

from places.made_places import random_places
from wayloom.config.classes import CLASS_ID
from wayloom.places.constellation import SIGMA_FLOOR_M, constellation
from wayloom.places.types import PlaceView
from wayloom.places.views import view_at

POLE, SIGN, ROAD = CLASS_ID["pole"], CLASS_ID["traffic sign"], CLASS_ID["road"]
FEET = np.array([[4.0, 10.0], [-5.0, -3.0], [6.0, 21.0]])
HEIGHTS = np.array([3.0, 6.0, 2.0])


def view(noise_m: float = 0.1, seed: int = 1) -> PlaceView:
    """Two poles and a sign on a plane 1.5 m below the camera, and a fence of poles that is too wide for one thing."""
    rng = np.random.default_rng(seed)
    things = [np.column_stack([np.tile(f, (40, 1)), rng.uniform(0.0, h, 40)]) for f, h in zip(FEET, HEIGHTS, strict=True)]
    things = [np.vstack([t, [*f, h]]) for t, f, h in zip(things, FEET, HEIGHTS, strict=True)]
    fence = np.column_stack([np.full(200, 12.0), np.linspace(-8.0, 0.0, 200), rng.uniform(0.0, 2.0, 200)])
    ground = np.column_stack([rng.uniform(-10, 10, (100, 2)), np.zeros(100)])
    xyz = np.concatenate([*things, fence, ground])
    xyz[:-100, :2] += rng.normal(0.0, noise_m, (len(xyz) - 100, 2))
    xyz[:, 2] -= 1.5
    label = np.repeat(np.array([POLE, POLE, SIGN, POLE, ROAD], np.uint8), [41, 41, 41, 200, 100])
    empty = view_at(random_places(1), 25)
    return replace(
        empty,
        xyz=xyz.astype(np.float32),
        label=label,
        sigma_m=np.full(len(xyz), 0.2, np.float32),
        camera=np.zeros(len(xyz), np.int32),
    )


def test_each_upright_thing_is_found_once_within_its_sigma():
    found = constellation(view())
    assert len(found) == len(FEET)
    at = np.argmin(np.linalg.norm(found.xy[:, None] - FEET[None], axis=2), axis=1)
    assert sorted(at.tolist()) == [0, 1, 2]
    assert (np.linalg.norm(found.xy - FEET[at], axis=1) < 3.0 * found.sigma_m).all()
    np.testing.assert_allclose(found.height_m, HEIGHTS[at], atol=0.05)
    np.testing.assert_array_equal(found.label, np.array([POLE, POLE, SIGN])[at])
    assert (found.sigma_m >= SIGMA_FLOOR_M).all()


def test_who_comes_the_other_way_finds_the_same_things_turned():
    ours, theirs = view(), view()
    theirs = replace(theirs, xyz=theirs.xyz * np.array([-1.0, -1.0, 1.0], np.float32))
    found, turned = constellation(ours), constellation(theirs)
    order, other = np.lexsort(found.xy.T), np.lexsort(-turned.xy.T)
    np.testing.assert_allclose(found.xy[order], -turned.xy[other], atol=1e-5)


def test_a_view_without_upright_things_has_none():
    road = view()
    assert len(constellation(replace(road, label=np.full(len(road), ROAD, np.uint8)))) == 0
