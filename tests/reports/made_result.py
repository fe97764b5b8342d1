"""A processed drive made from numbers: a street of 60 m with a wall, a road and a car, seen in 30 small frames."""

import dataclasses
from pathlib import Path

import cv2
import numpy as np

from wayloom.config.classes import CLASS_ID, VOID
from wayloom.config.stages import drive_stages
from wayloom.geometry import se3
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.georeference.alignment import georeference
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.labelling.types import PointLabels
from wayloom.logs.drive_writer import SensorExtrinsics
from wayloom.logs.inspection import inspect_log
from wayloom.logs.kitti.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.registry import open_log
from wayloom.logs.sidecars.oxts_writer import OxtsPacket
from wayloom.logs.types import FixType, StereoFrame
from wayloom.loops.types import LoopClosures
from wayloom.odometry.types import Keyframes, OdometryResult, Points, Trajectory, no_points
from wayloom.pipeline.drive_quality import drive_quality
from wayloom.pipeline.drive_result import DriveResult, StageTime
from wayloom.segmentation.keyframe_labels import KeyframeLabels
from wayloom.submaps.split import make_submaps

FRAMES, KEYFRAME_EVERY, POINTS = 30, 5, 900
CAMERA = PinholeCamera(200.0, 200.0, 159.5, 47.5, 320, 96)
RIG = StereoRig(CAMERA, (-0.5, 0.0, 0.0))
METRES_PER_DEGREE = 111_320.0


def made_path() -> np.ndarray:
    """(N, 4, 4) T_world_cam: 2 m a frame, in a gentle bend to the right."""
    T = [np.eye(4)]
    for _ in range(FRAMES - 1):
        T.append(T[-1] @ se3.exp(np.array([0.0, 0.0, 2.0, 0.0, 0.01, 0.0])))
    return np.array(T)


def write_log(folder: Path, T: np.ndarray, *, gnss: bool, truth: bool) -> None:
    rng = np.random.default_rng(3)
    with KittiOdometryWriter(folder, RIG, extrinsics=SensorExtrinsics(p_cam_gnss=np.array([0.0, -1.0, 0.0]))) as writer:
        for i in range(FRAMES):
            image = rng.integers(60, 200, (CAMERA.height, CAMERA.width, 3), dtype=np.uint8)
            writer.add(StereoFrame(i, i * 10**8, image, image), T[i] if truth else None)
            if gnss:
                x, _, z = T[i, :3, 3]
                place = (8.4 + x / METRES_PER_DEGREE / np.cos(np.radians(49.0)), 49.0 + z / METRES_PER_DEGREE, 117.0)
                writer.add_gnss(OxtsPacket(i * 10**8, place, 0.3, FixType.FIXED if i < 20 else FixType.FLOAT))


def made_odometry(T: np.ndarray, lost: tuple[int, ...] = ()) -> OdometryResult:
    rng = np.random.default_rng(4)
    frames = np.arange(0, FRAMES, KEYFRAME_EVERY, dtype=np.int32)
    tracked = np.ones(FRAMES, bool)
    tracked[list(lost)] = False
    segment = np.cumsum(~tracked).astype(np.int32)
    host = np.sort(rng.integers(0, len(frames), POINTS)).astype(np.int32)
    uv = np.column_stack([rng.uniform(5, CAMERA.width - 6, POINTS), rng.uniform(5, CAMERA.height - 6, POINTS)])
    trajectory = Trajectory(np.arange(FRAMES, dtype=np.int64) * 10**8, T, tracked, segment)
    points = Points(
        host=host,
        uv_host=uv.astype(np.float32),
        inverse_depth=(1.0 / rng.uniform(5.0, 30.0, POINTS)).astype(np.float32),
        variance=np.full(POINTS, 1e-7, np.float32),
        grey=np.full(POINTS, 120, np.uint8),
        obs_start=np.zeros(POINTS + 1, np.int64),
        obs_keyframe=np.empty(0, np.int32),
        obs_right=np.empty(0, bool),
        host_right=np.ones(POINTS, bool),
    )
    keyframes = Keyframes(frames, T[frames], np.zeros((len(frames), 4)), segment[frames])
    return OdometryResult(
        RIG,
        trajectory,
        keyframes,
        points,
        -0.4,
        np.array([0.1, 0.2, 6.0]),
        {"losses": [{"frame": frame, "reason": "the image is blank"} for frame in lost]},
    )


def made_labels() -> PointLabels:
    rng = np.random.default_rng(5)
    stereo = rng.choice([CLASS_ID["road"], CLASS_ID["building"], CLASS_ID["car"], VOID], POINTS, p=[0.6, 0.3, 0.08, 0.02])
    baseline = np.where(rng.random(POINTS) < 0.1, CLASS_ID["sidewalk"], stereo)
    stereo, baseline = stereo.astype(np.uint8), baseline.astype(np.uint8)
    voted = stereo != VOID
    start = np.concatenate([[0], np.cumsum(voted)])
    return PointLabels(baseline, baseline, stereo, start, stereo[voted], np.full(int(voted.sum()), 0.1, np.float32))


def write_label_images(folder: Path, frames: np.ndarray) -> KeyframeLabels:
    labels = np.full((CAMERA.height, CAMERA.width), CLASS_ID["road"], np.uint8)
    labels[: CAMERA.height // 2] = CLASS_ID["building"]
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for frame in frames.tolist():
            cv2.imwrite(str(folder / side / f"{frame:010d}.png"), labels)
    return KeyframeLabels(folder, frames)


ON_ONE_PULSE = GeoReferenceSettings(time_offset_sigma_s=0.0002)
"""A straight drive would not tell the receiver's clock, and say so."""


def made_result(
    folder: Path,
    *,
    gnss: bool = True,
    truth: bool = True,
    lost: tuple[int, ...] = (),
    name: str = "made",
    loops: LoopClosures | None = None,
) -> DriveResult:
    T = made_path()
    write_log(folder / name, T, gnss=gnss, truth=truth)
    log = open_log(folder / name)
    drift = T.copy()
    drift[:, :3, 3] *= 1.01
    odometry = made_odometry(drift, lost)
    labels, geo = made_labels(), georeference(log, odometry, settings=ON_ONE_PULSE)
    quality = drive_quality(odometry, geo, loops)
    return DriveResult(
        log=log,
        log_facts={"name": log.name, "log": inspect_log(log).model_dump(mode="json")},
        model={"name": "made", "licence": "Apache-2.0", "grey_images_to_a_colour_network": False},
        odometry=dataclasses.replace(odometry, points=no_points()),
        observations=len(odometry.points.obs_keyframe),
        images=write_label_images(folder / "segmentation", odometry.keyframes.frame),
        labels=labels,
        geo=geo,
        submaps=list(make_submaps(log, odometry, labels, geo)),
        quality=quality,
        objects=[],
        times={stage: StageTime(1.5 * i + 0.1, stage == "ingest") for i, stage in enumerate(drive_stages())},
    )


def renamed(result: DriveResult, name: str) -> DriveResult:
    facts = {**result.log_facts, "log": {**result.log_facts["log"], "name": name}}
    return dataclasses.replace(result, log_facts=facts)
