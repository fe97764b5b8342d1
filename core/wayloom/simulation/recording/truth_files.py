"""Ground-truth writer of a drive: depth, class and instance images, poses, objects, areas, sensor parameters.

`wayloom.logs.simulated_truth` reads it; its docstring says what each file holds.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.config.classes import CLASS_NAMES, PALETTE, SKY
from wayloom.files.atomic import link_or_copy, write_atomically
from wayloom.files.ply import write_vertices
from wayloom.geodesy.wgs84 import lonlatheight_from_enu
from wayloom.logs import simulated_truth as files
from wayloom.logs.drive_writer import encoded_map, numbers_text
from wayloom.logs.kitti.accumulation import VoxelFilter
from wayloom.logs.simulated_truth import CAMERAS, DEPTH_PER_M, IMAGE_KINDS
from wayloom.simulation.city.city import City
from wayloom.simulation.city.objects import Area
from wayloom.simulation.recording.presets import CITY_ORIGIN
from wayloom.simulation.rendering.renderer import Truth
from wayloom.simulation.sensors.exposure import Exposure
from wayloom.simulation.sensors.gnss import GnssRecord
from wayloom.simulation.sensors.imu import ImuRecord
from wayloom.simulation.sensors.optics import TrueCamera
from wayloom.simulation.traffic.traffic import FIRST_MOVER
from wayloom.simulation.vehicle.rigs import given_rig
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

F64 = NDArray[np.float64]
SURFACE_REACH_M, SURFACE_VOXEL_M = 50.0, 0.1
AROUND_M: Final = 120.0
"""How far around the way objects and areas are told."""
METRES: Final = 4
DEGREES: Final = 10


class TruthFolder:
    """Writer of a drive's ground truth. The images of different frames may come in any order and from several threads."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write_images(self, index: int, truths: tuple[Truth, Truth]) -> None:
        """Depth, class and instance of both cameras."""
        for camera, truth in zip(CAMERAS, truths, strict=True):
            scaled = np.rint(truth.depth * DEPTH_PER_M)
            depth = np.where(scaled <= np.iinfo(np.uint16).max, scaled, 0).astype(np.uint16)
            images: tuple[NDArray[np.integer], ...] = (depth, truth.class_id, truth.instance)
            for kind, image in zip(IMAGE_KINDS, images, strict=True):
                file = files.image_file(self.folder, kind, camera, index)
                write_atomically(file, encoded_map(image))

    def write_scan_labels(self, index: int, class_id: NDArray[np.uint8], instance: NDArray[np.uint16]) -> None:
        """Class and instance (N,) of each point of a scan."""
        both = class_id.astype("<u4") | (instance.astype("<u4") << 16)
        write_atomically(files.scan_label_file(self.folder, index), both.astype("<u4").tobytes())

    def repeat(self, index: int, source: int) -> None:
        """Make the truth images and scan of a frame those of another."""
        old, new = (files.frame_files(self.folder, frame) for frame in (source, index))
        for file, copy in zip(old, new, strict=True):
            if file.is_file():
                link_or_copy(file, copy)

    def write_poses(self, T_enu_cam: F64) -> None:
        """T_enu_cam (N, 4, 4) of the left camera."""
        lines = (numbers_text(np.round(T[:3], 12)) + "\n" for T in T_enu_cam)
        write_atomically(self.folder / files.POSES_NAME, "".join(lines).encode())

    def write_frames(
        self, t_ns: NDArray[np.int64], exposures: Sequence[tuple[Exposure, ...]], t_s: F64, inertia: ImuRecord | None
    ) -> None:
        """Write the values of each frame: exposure of left and right, IMU biases."""
        columns = [[getattr(pair[side], name) for pair in exposures] for side in (0, 1) for name in ("exposure_s", "gain")]
        names = list(files.EXPOSURE_COLUMNS)
        if inertia is not None:
            names += files.BIAS_COLUMNS
            bias = np.column_stack([inertia.force_bias, inertia.rate_bias])
            columns += [np.interp(t_s, inertia.t_s, bias[:, k]).tolist() for k in range(6)]
        rows = zip(t_ns.tolist(), *columns, strict=True)
        lines = (",".join([str(t), *(repr(float(value)) for value in values)]) + "\n" for t, *values in rows)
        write_atomically(self.folder / files.FRAMES_NAME, f"{','.join(['t_ns', *names])}\n{''.join(lines)}".encode())

    def write_fixes(self, fixes: GnssRecord, zero_ns: int) -> None:
        """Write each fix's true time on the cameras' clock, true antenna position, error and its cause.

        zero_ns  time stamp of the city's time zero"""
        rows = zip(
            fixes.t_s, fixes.antenna_enu, fixes.measured_enu - fixes.antenna_enu, fixes.sigma_m, fixes.multipath, strict=True
        )
        lines = (
            ",".join([str(zero_ns + round(t * 1e9)), *(f"{v:.6f}" for v in (*place, *error, sigma)), str(int(multipath))]) + "\n"
            for t, place, error, sigma, multipath in rows
        )
        write_atomically(self.folder / files.FIXES_NAME, f"{','.join(files.FIX_COLUMNS)}\n{''.join(lines)}".encode())

    def write_vehicle(self, vehicle: VehicleSettings, size: str, cameras: tuple[TrueCamera, TrueCamera]) -> None:
        """Write the rig as calibrated and as it is, and all settings of the vehicle."""
        given = given_rig(vehicle, size)
        lens = vehicle.right_lens.lens(given.camera.width / given_rig(vehicle, "full").camera.width)
        content = {
            "given_rig": {**_camera(given.camera), "t_right_left_m": given.t_right_left},
            "true_right_lens": {name: getattr(lens, name) for name in sorted(type(vehicle.right_lens).model_fields)},
            "T_left_right": _rows(cameras[1].T_left_cam),
            "T_body_cam": _rows(vehicle.T_body_cam),
            "T_cam_imu": _rows(vehicle.T_cam_imu),
            "T_cam_lidar": _rows(vehicle.T_cam_lidar),
            "p_cam_gnss_m": vehicle.p_cam_gnss_m,
            "clock": vehicle.clock.model_dump(),
            "vehicle": vehicle.model_dump(mode="json"),
        }
        self._write_json(files.VEHICLE_NAME, content)

    def write_surface(self, left: TrueCamera, T_enu_cam: F64) -> None:
        """Write the static surface that the left camera saw: one point in each voxel, the first seen."""
        rays = _rays(left)
        known, parts = VoxelFilter(SURFACE_VOXEL_M), []
        for index, T in enumerate(T_enu_cam):
            depth, label, instance = (files.read_image(self.folder, kind, "left", index) for kind in IMAGE_KINDS)
            near = (depth > 0) & (depth < SURFACE_REACH_M * DEPTH_PER_M) & (instance < FIRST_MOVER) & (label != SKY)
            p_cam = rays[near] * (depth[near] / DEPTH_PER_M)[:, None]
            points = p_cam @ T[:3, :3].T + T[:3, 3]
            new = known.new(points)
            rows = np.empty(len(new), files.SURFACE_POINT)
            rows["x"], rows["y"], rows["z"] = points[new].T
            rows["label"], rows["instance"] = label[near][new], instance[near][new]
            rows["red"], rows["green"], rows["blue"] = PALETTE[rows["label"]].T
            parts.append(rows)
        comment_lines = ("frame enu", f"first point seen in each voxel of {SURFACE_VOXEL_M} m")
        write_vertices(self.folder / files.SURFACE_NAME, np.concatenate(parts), comment_lines)

    def write_city(self, city: City, T_enu_cam: F64) -> None:
        """Write objects, outlines of roads and sidewalks, markings and kerbs around the trajectory."""
        low, high = T_enu_cam[:, :2, 3].min(axis=0) - AROUND_M, T_enu_cam[:, :2, 3].max(axis=0) + AROUND_M
        area = Area((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
        objects = [
            _feature(
                {"type": "Point", "coordinates": _lonlatheight(thing.foot[None])[0]},
                class_id=int(thing.class_id), instance=int(thing.instance), foot_enu_m=_metres(thing.foot),
                bottom_m=round(float(thing.bottom_m), METRES), height_m=round(float(thing.height_m), METRES),
            )
            for thing in city.objects(area)
        ]  # fmt: skip
        areas = [
            _feature(
                {"type": "Polygon", "coordinates": [_lonlatheight(ring) for ring in (part.ring, *part.holes)]},
                class_id=int(part.class_id), rings_enu_m=[[_metres(p) for p in ring] for ring in (part.ring, *part.holes)],
            )
            for part in city.areas(area)
        ]  # fmt: skip
        found = ((files.OBJECTS_NAME, objects), (files.AREAS_NAME, areas), (files.MARKINGS_NAME, _painted(city, area)))
        for name, features in found:
            self._write_json(name, {"type": "FeatureCollection", "features": features})

    def _write_json(self, name: str, content: dict[str, Any]) -> None:
        write_atomically(self.folder / name, (json.dumps(content, indent=1) + "\n").encode())


def _rays(camera: TrueCamera) -> F64:
    """(h, w, 3) the direction in which each pixel looks, z = 1."""
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    uv = np.stack([u, v], axis=-1) if camera.lens_uv is None else camera.lens_uv.astype(np.float64)
    return np.asarray(camera.rendered.rays(uv.reshape(-1, 2)).reshape(camera.height, camera.width, 3))


def _camera(camera: Any) -> dict[str, float]:
    return {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}


def _rows(T: F64) -> list[list[float]]:
    return [[float(value) for value in row] for row in T]


def _metres(point: F64) -> list[float]:
    return [round(float(value), METRES) for value in point]


def _lonlatheight(points_enu: F64) -> list[list[float]]:
    lon_lat_height = lonlatheight_from_enu(points_enu, CITY_ORIGIN)
    return [[round(float(lon), DEGREES), round(float(lat), DEGREES), round(float(h), METRES)] for lon, lat, h in lon_lat_height]


def _painted(city: City, area: Area) -> list[dict[str, Any]]:
    """Features of markings and kerbs."""
    out = []
    for marking in city.markings(area):
        out.append({
            "type": "Feature", "geometry": {"type": "Polygon", "coordinates": [_lonlatheight(marking.ring)]},
            "properties": {
                "kind": marking.kind, "width_m": round(marking.width_m, METRES), "length_m": round(marking.length_m, METRES),
                "line_enu_m": [_metres(p) for p in marking.line], "ring_enu_m": [_metres(p) for p in marking.ring],
            },
        })  # fmt: skip
    for kerb in city.kerbs(area):
        out.append({
            "type": "Feature", "geometry": {"type": "LineString", "coordinates": _lonlatheight(kerb.line)},
            "properties": {"kind": "kerb", "height_m": kerb.height_m, "line_enu_m": [_metres(p) for p in kerb.line]},
        })  # fmt: skip
    return out


def _feature(geometry: dict[str, Any], **properties: Any) -> dict[str, Any]:
    named = {"class": CLASS_NAMES[properties["class_id"]], **properties}
    return {"type": "Feature", "geometry": geometry, "properties": named}
