from typing import Any

import numpy as np
import pytest

from reports.made_result import made_result
from wayloom.pipeline.drive_result import DriveResult
from wayloom.rendering.cameras import street_level
from wayloom.reports import triple

WHOLE = ["The cloud as the cameras saw it, with the way", "The same with classes"]
STREET = "From the street, halfway"


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> DriveResult:
    return made_result(tmp_path_factory.mktemp("made"))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many points each scene has that is made."""
    counts, make = [], triple.scene_of_points

    def counted(points: Any, *others: Any) -> Any:
        counts.append(len(points))
        return make(points, *others)

    monkeypatch.setattr(triple, "scene_of_points", counted)
    return counts


def test_all_points_of_a_drive_are_drawn_from_beside_and_from_the_street(result: DriveResult, drawn: list[int]) -> None:
    views = triple.cloud_views(result)
    assert [*views] == [*WHOLE, STREET]
    assert drawn == 2 * [sum(len(placed.submap) for placed in result.submaps)]
    assert all(view.shape == (520, 1100, 3) for view in views.values())


def test_of_very_many_points_each_so_manieth_is_drawn(
    result: DriveResult, drawn: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = triple.cloud_views(result)
    monkeypatch.setattr(triple, "MOST_DRAWN", drawn[0] // 2)
    thin = triple.cloud_views(result)
    assert drawn[2:] == pytest.approx(2 * [drawn[0] / 2], abs=len(result.submaps))
    for name, view in whole.items():  # the same view, with half the points
        assert 1.0 < np.abs(view.astype(int) - thin[name]).mean() < 30.0, name


def test_halfway_is_the_middle_of_the_road_however_long_the_drive_stood() -> None:
    corner = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [10.0, 30.0, 0.0]])
    standing = np.concatenate([np.repeat(corner[:1], 500, axis=0), corner, np.repeat(corner[-1:], 20, axis=0)])
    np.testing.assert_allclose(triple.halfway(standing), [10.0, 10.0, 0.0])
    np.testing.assert_allclose(triple.halfway(corner[:1]), corner[0])
    way = np.column_stack([np.repeat(np.linspace(0.0, 4000.0, 400), 4)[:-600], np.zeros(1000), np.zeros(1000)])
    way = np.concatenate([way, np.column_stack([np.linspace(way[-1, 0], 8000.0, 50), np.zeros(50), np.zeros(50)])])  # faster now
    eye = np.linalg.inv(street_level(way, triple.SIZE_PX).T_view_scene)[:3, 3]
    assert np.linalg.norm(triple.halfway(way) - eye) < 20.0


def test_from_the_street_what_is_out_of_sight_is_not_drawn(
    result: DriveResult, drawn: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(triple, "SIGHT_M", 0.0)
    assert [*triple.cloud_views(result)] == WHOLE
    assert len(drawn) == 1
