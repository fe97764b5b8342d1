"""Pictures and flights of scenes: what is nearer hides what is behind, colours and legends say what is there."""

from pathlib import Path

import cv2
import laspy
import numpy as np
import pytest

from exports.made_sources import drives_with_ground, made_source
from wayloom.config.classes import CLASS_ID, PALETTE
from wayloom.errors import InputError, UnknownFormatError
from wayloom.exports.cloud_files import read_cloud
from wayloom.exports.drive_outputs import DriveOutputs
from wayloom.exports.formats import Export, export_map
from wayloom.files.ply import write_ply
from wayloom.rendering.cameras import Viewpoint, flight, from_above, looking, oblique
from wayloom.rendering.colouring import COLOURINGS, by_class, by_drive, by_height
from wayloom.rendering.kernels.splatting import eye_dome, splat
from wayloom.rendering.render import Look, render, shown
from wayloom.rendering.scene import Scene, scene_of_file, scene_of_map

pytestmark = pytest.mark.kernels
ROAD, BUILDING = CLASS_ID["road"], CLASS_ID["building"]


def made_scene(points: np.ndarray, label: int | np.ndarray = ROAD, tracks: tuple[np.ndarray, ...] = ()) -> Scene:
    count = len(points)
    labels = np.broadcast_to(np.asarray(label, np.uint8), count)
    names = tuple(f"d{row}" for row in range(len(tracks)))
    return Scene(
        points.astype(np.float32), labels, np.full((count, 3), 128, np.uint8), np.full(count, 0.3, np.float32),
        np.zeros(count, np.int16), tracks, names, True,
    )  # fmt: skip


def street() -> Scene:
    """A flat road of 40 x 8 m under a wall along its northern edge, and a way along it."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 40, 0.25), np.arange(-4, 4, 0.25)))
    wall = np.stack(np.meshgrid(np.arange(0, 40, 0.25), [4.0], np.arange(0, 6, 0.25)), axis=-1).reshape(-1, 3)
    points = np.vstack([np.column_stack([x, y, 0 * x]), wall])
    label = np.r_[np.full(len(x), ROAD), np.full(len(wall), BUILDING)]
    way = np.column_stack([np.linspace(0, 40, 81), np.full(81, -2.0), np.full(81, 1.6)])
    return made_scene(points, label, (way,))


def naive_splat(uv: np.ndarray, depth: np.ndarray, radius: np.ndarray, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Every pixel asks every point."""
    nearest, seen = np.full(size, np.inf, np.float32), np.full(size, -1, np.int32)
    for row in range(size[0]):
        for column in range(size[1]):
            for p, z in enumerate(depth):
                r = max(radius[p], 0.5)
                if z > 0 and (column - uv[p, 0]) ** 2 + (row - uv[p, 1]) ** 2 <= r * r + 1e-6 and z < nearest[row, column]:
                    nearest[row, column], seen[row, column] = z, p
    return nearest, seen


def test_splats_are_those_of_a_loop_over_pixels_and_points() -> None:
    rng = np.random.default_rng(3)
    uv = rng.uniform(-3, 23, (60, 2)).astype(np.float32)
    depth = rng.uniform(-1, 9, 60).astype(np.float32)
    uv[5], depth[6] = np.nan, np.nan
    radius = rng.uniform(0, 4, 60).astype(np.float32)
    nearest, seen = np.full((16, 20), np.inf, np.float32), np.full((16, 20), -1, np.int32)
    splat(uv, depth, radius, nearest, seen)
    expected = naive_splat(uv, depth, radius, (16, 20))
    assert np.array_equal(nearest, expected[0])
    assert np.array_equal(seen, expected[1])
    assert (seen >= 0).any()
    assert (seen < 0).any()


def test_light_falls_where_neighbours_are_nearer_and_nowhere_else() -> None:
    depth = np.full((9, 9), 10.0, np.float32)
    depth[:, 5:] = 9.8
    depth[0] = np.inf
    shade, steps = np.empty_like(depth), np.array([[1, 0], [-1, 0]])
    eye_dome(depth, steps, 0.5, 0.0, shade)
    assert shade[4, 4] == pytest.approx(0.2 / 0.5 / 2, abs=1e-5)
    assert shade[4, 5] == shade[4, 1] == 0.0
    assert (shade[0] == 0.0).all()
    depth[:, 5:] = 1.0
    eye_dome(depth, steps, 0.5, 0.0, shade)
    assert shade[4, 4] == pytest.approx(0.75)  # a step counts 1.5 softnesses at most


def test_a_viewpoint_projects_what_it_looks_at_to_the_middle_with_the_horizon_level() -> None:
    eye, target = np.array([1.0, -8.0, 5.0]), np.array([4.0, 2.0, 0.5])
    view = Viewpoint(looking(eye, target), (201, 101), 150.0)
    up = target + np.array([0.0, 0.0, 0.5])
    uv, depth, scale = view.project(np.array([target, up, eye - (target - eye)], np.float32))
    assert uv[0] == pytest.approx([100.0, 50.0], abs=1e-3)
    assert uv[1, 0] == pytest.approx(100.0, abs=1e-3)
    assert uv[1, 1] < 50.0
    assert depth[0] == pytest.approx(np.linalg.norm(target - eye), abs=1e-4)
    assert scale[0] == pytest.approx(150.0 / depth[0])
    assert depth[2] < 0.0


@pytest.mark.parametrize("view", ["above", "oblique"])
def test_nearly_all_points_of_a_scene_are_in_the_picture_and_fill_it(view: str) -> None:
    points = street().points
    found = from_above(points, 800) if view == "above" else oblique(points, (800, 450))
    uv, _, _ = found.project(points)
    inside = ((uv >= 0) & (uv < np.array(found.size_px))).all(axis=1)
    assert inside.mean() > 0.98
    assert (np.ptp(uv, axis=0) / np.array(found.size_px)).max() > 0.85


def test_the_way_is_in_the_picture_from_end_to_end_even_where_no_points_are() -> None:
    scene = street()
    way = np.vstack([scene.tracks[0], scene.tracks[0][-1] + np.array([[12.0, 0.0, 0.0]])])
    for ways, all_shown in (((), False), ((way,), True)):
        view = oblique(scene.points, (800, 450), None, ways)
        uv, _, _ = view.project(way.astype(np.float32))
        assert bool(((uv >= 0) & (uv < np.array(view.size_px))).all()) == all_shown


def test_a_flight_goes_forward_along_the_way_and_looks_ahead() -> None:
    views = [*flight(street().tracks[0], (320, 180), 12)]
    eyes = np.array([-view.T_view_scene[:3, :3].T @ view.T_view_scene[:3, 3] for view in views])
    assert (np.diff(eyes[:, 0]) > 0.5).all()
    assert np.ptp(np.diff(eyes[:, 0])) < 0.2
    assert (eyes[:, 2] > 5.0).all()
    assert all(view.T_view_scene[2, 0] > 0.8 for view in views)


def test_from_above_a_roof_hides_the_road_in_the_colours_of_their_classes() -> None:
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, 10, 0.1), np.arange(0, 10, 0.1)))
    roof = (x > 5.0).astype(float)
    scene = made_scene(np.vstack([np.column_stack([x, y, 0 * x]), np.column_stack([x, y, 4.0 * roof])[x > 5.0]]))
    label = scene.label.copy()
    label[len(x) :] = BUILDING
    scene = made_scene(scene.points.astype(float), label)
    picture = shown(scene, Look("top", "class", 400, legend=False)).astype(int)
    assert np.abs(picture[200, 100] - PALETTE[ROAD]).max() < 12
    assert np.abs(picture[200, 300] - PALETTE[BUILDING]).max() < 12


def test_legends_list_what_is_there_and_nothing_else() -> None:
    scene = street()
    assert [*by_class(scene)[1].entries] == ["road", "building"]
    assert [*by_drive(scene)[1].entries] == ["d0"]
    ramp = by_height(scene)[1].ramp
    assert ramp is not None
    assert (ramp[1], round(ramp[2])) == (0.0, 6)
    assert {*COLOURINGS} == {"class", "height", "grey", "drives"}


def test_a_map_has_its_voxels_its_ground_and_its_ways(tmp_path: Path) -> None:
    source = DriveOutputs(drives_with_ground(tmp_path))
    scene = scene_of_map(source)
    voxels = sum(len(found) for key in source.keys if (found := source.voxels(key)) is not None)
    assert len(scene) > voxels + 1000  # the ground
    assert len(scene.tracks) == len(scene.drives) == 2
    assert np.abs(np.median(scene.points, axis=0)).max() < 100.0  # near the origin, where float32 has tenths of millimetres
    assert (np.ptp(scene.photo[voxels:], axis=1) >= 0).all()
    with pytest.raises(InputError, match="nothing to see"):
        scene_of_map(source, (0.0, 0.0, 1.0, 1.0))


@pytest.mark.parametrize("suffix", [".laz", ".copc.laz", ".ply"])
def test_cloud_files_come_back_with_their_labels(suffix: str, tmp_path: Path) -> None:
    source, out = made_source(800), tmp_path / f"cloud{suffix}"
    export_map(Export(source, out))
    scene = scene_of_file(out)
    assert np.array_equal(np.bincount(scene.label), np.bincount(source.whole.label))
    assert scene.north_up is (suffix != ".ply")
    assert np.ptp(scene.points, axis=0) == pytest.approx(np.ptp(source.whole.points_enu, axis=0), abs=1.5)


def test_a_cloud_of_others_is_labelled_by_the_standards_classes_and_coloured_by_its_photographs(tmp_path: Path) -> None:
    las = laspy.create(point_format=2, file_version="1.2")
    las.x, las.y, las.z = np.arange(3.0), np.zeros(3), np.zeros(3)
    las.classification = np.array([2, 6, 5])
    las.red, las.green, las.blue = np.array([[65535, 0, 257]] * 3, np.uint16).T
    las.write(tmp_path / "other.las")
    cloud = read_cloud(tmp_path / "other.las")
    assert cloud.labels.tolist() == [CLASS_ID["terrain"], BUILDING, CLASS_ID["vegetation"]]
    assert cloud.photo.tolist() == [[255, 0, 1]] * 3
    assert not cloud.is_geographic
    (tmp_path / "broken.laz").write_bytes(b"LASF and no more")
    with pytest.raises(InputError, match="cannot be read"):
        read_cloud(tmp_path / "broken.laz")
    with pytest.raises(UnknownFormatError, match="known are"):
        read_cloud(tmp_path / "cloud.e57")


@pytest.mark.parametrize("name", ["flight.mp4", "flight.webm", "flight.gif", "frames"])
def test_a_flight_is_a_film_that_can_be_read_again(name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / name
    render(street(), Look("fly", "height", 160, 96, seconds=0.24), out)
    assert capfd.readouterr() == ("", "")
    if out.suffix == "":
        frames = [cv2.imread(str(file)) for file in sorted(out.iterdir())]
    elif out.suffix == ".gif":
        read, film = cv2.imreadanimation(str(out))
        assert read
        frames = [frame[..., :3] for frame in film.frames]
    else:
        film = cv2.VideoCapture(str(out))
        frames = []
        while (read := film.read())[0]:
            frames.append(read[1])
    assert len(frames) == (3 if out.suffix == ".gif" else 6)
    assert {frame.shape for frame in frames} == {(96, 160, 3)}
    assert np.abs(frames[0].astype(int) - frames[-1].astype(int)).max() > 30
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_what_cannot_be_drawn_is_told_before_anything_is_read(tmp_path: Path) -> None:
    write_ply(tmp_path / "a.ply", np.zeros((1, 3)), np.zeros((1, 3), np.uint8), np.zeros(1, np.uint8))
    scene = scene_of_file(tmp_path / "a.ply")
    for look, name, what in (
        (Look("top"), "a.tga", "no picture"), (Look("fly"), "a.avi", "no film"), (Look("top", "age"), "a.png", "known are class"),
        (Look("fly"), "a.mp4", "no way to fly along"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=what):
            render(scene, look, tmp_path / name)
    assert [one.name for one in tmp_path.iterdir()] == ["a.ply"]
