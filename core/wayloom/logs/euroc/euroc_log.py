"""EuRoC/ASL reader: `mav0/cam0`, `mav0/cam1`, `mav0/imu0` and ground truth (Burri et al. 2016).

Images are as the lenses made them; they are rectified as they are read. Neither is there GNSS in the format: fixes may lie in a
gnss.csv beside `mav0`, as wayloom.json may.
"""

from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.files.text_files import utf8_text
from wayloom.files.timestamps import NS
from wayloom.geometry import se3
from wayloom.geometry.rectification import rectifying_maps
from wayloom.logs.euroc.asl_yaml import read_asl_settings
from wayloom.logs.euroc.euroc_calibration import EurocRig, find_rig
from wayloom.logs.euroc.euroc_tables import ImageList, poses_at, read_image_list, read_imu, read_poses
from wayloom.logs.images.image_files import ImagePairs, first_header
from wayloom.logs.kitti.image_folder_log import ImageFolderLog, LogFiles, Rectifier, StereoSequence, assemble, check_size
from wayloom.logs.kitti.positioning import LEAST_IMU_RATE_HZ, FrameClock, Positioning, find_positioning
from wayloom.logs.sidecars.sidecar import Sidecar, read_sidecar
from wayloom.logs.stereo_pairing import taken_together
from wayloom.logs.types import FloatArray

FORMAT: Final = "euroc"
BODY: Final = "mav0"
LOOKS_FOR: Final = "mav0 with cam0, cam1 and imu0, each with sensor.yaml and data.csv"
TRUTHS: Final = ("state_groundtruth_estimate0", "mocap0", "vicon0")


def recognise(path: Path) -> bool:
    """Whether a folder holds `mav0` with a camera, or is that."""
    return any((folder / "cam0" / "data.csv").is_file() or (folder / "cam0" / "data").is_dir() for folder in (path / BODY, path))


def open_euroc(path: Path, gnss: Path | None = None) -> ImageFolderLog:
    """Open without decoding images. Raises LogError or CalibrationError."""
    body = path / BODY if (path / BODY).is_dir() else path
    for name in ("cam0", "cam1"):
        if not (body / name).is_dir():
            remedy = "a stereo log needs both cameras' images"
            raise LogError("no such folder", file=body / name, remedy=remedy, reason="image.missing")
    rig = find_rig(body)
    pairs, t_ns, listed, lacking = paired_images(body, rig.names)
    header = first_header(pairs.left)
    sizes = [(camera.lens.camera.width, camera.lens.camera.height) for camera in rig.cameras]
    check_size(header, sizes[0], pairs.left[0])
    sidecar = read_sidecar(path)
    positioning = find_positioning(path, gnss, FrameClock(pairs.numbers, t_ns), np.eye(3, 4), sidecar)
    positioning = with_imu(positioning, body, rig, FrameClock(pairs.numbers, t_ns), sidecar)
    truth, truth_files = read_truth(body, rig, t_ns)
    tables = [body / name / file for name in rig.names for file in ("sensor.yaml", "data.csv")]
    location = LogFiles(path, path, [*tables, *truth_files], sidecars=path)
    sequence = StereoSequence(rig.rectification.rig, t_ns, pairs, header, (sizes[0], sizes[1]), rectifier_of(rig), listed)
    missing = (*lacking, *(() if truth is not None else ("truth poses",)))
    log = assemble(FORMAT, location, sequence, positioning, sidecar, truth, missing)
    return log if path.name != BODY else replace(log, name=utf8_text(path.parent.name or BODY))


def paired_images(body: Path, names: tuple[str, str]) -> tuple[ImagePairs, NDArray[np.int64], int, tuple[str, ...]]:
    """The pairs, their time stamps (N,), how many images the left list has, and what is missing, in words.

    A pair's number is its row in the left list, by which packets and exposures know it. Images that are listed but not there,
    and images without a partner, are left out. Raises LogError where no pair is left.
    """
    sides, lacking, numbers, counts = [], [], [], []
    for name in names:
        listed = read_image_list(body / name / "data.csv", body / name / "data")
        there = [row for row, file in enumerate(listed.files) if file.exists()]
        if len(there) < len(listed.files):
            lacking.append(f"{len(listed.files) - len(there)} of {len(listed.files)} images that {name}/data.csv lists")
        numbers.append(there)
        counts.append(len(listed.files))
        sides.append(ImageList(listed.t_ns[there], listed.files.kept(there)))
    left, right = sides
    rows = taken_together(left.t_ns, right.t_ns)
    if not len(rows[0]):
        what = f"no image of {names[1]} was taken with one of {names[0]} ({len(left.files)} and {len(right.files)} images)"
        raise LogError(
            what,
            file=body / names[0] / "data.csv",
            remedy="the cameras must be triggered together, on one clock",
            reason="image.unpaired",
        )
    for side, other, kept in ((0, 1, rows[0]), (1, 0, rows[1])):
        without = len(sides[side].files) - len(kept)
        if without:
            lacking.append(f"{names[other]} image for {without} of {len(sides[side].files)} of {names[side]}")
    pairs = ImagePairs(
        tuple(numbers[0][row] for row in rows[0]),
        left.files.kept(rows[0].tolist()),
        right.files.kept(rows[1].tolist()),
    )
    return pairs, left.t_ns[rows[0]], counts[0], tuple(lacking)


def rectifier_of(rig: EurocRig) -> Rectifier | None:
    """The sampling maps of both cameras, None where images are rectified as they stand."""
    found = rig.rectification
    if found.is_given:
        return None
    left, right = (
        rectifying_maps(camera.lens, R, found.rig.camera)
        for camera, R in zip(rig.cameras, (found.R_left, found.R_right), strict=True)
    )
    return Rectifier(left, right)


def with_imu(found: Positioning, body: Path, rig: EurocRig, clock: FrameClock, sidecar: Sidecar) -> Positioning:
    """The positioning with the samples of imu0, unless an imu.csv beside `mav0` gave others. Raises LogError."""
    table, calibration = body / "imu0" / "data.csv", body / "imu0" / "sensor.yaml"
    if found.imu is not None or not table.is_file():
        return found
    without = tuple(what for what in found.missing if what != "IMU")
    track, stale = read_imu(table)
    rate_hz = (len(track.t_ns) - 1) * NS / max(int(track.t_ns[-1] - track.t_ns[0]), 1)
    if rate_hz < LEAST_IMU_RATE_HZ:
        return replace(found, missing=(*without, f"IMU: imu0 comes at {rate_hz:.1f} Hz, which is too slow"))
    if not clock.overlaps(track.t_ns):
        gap_s = (int(track.t_ns[0]) - int(clock.t_ns[0])) / NS
        what = f"the samples start {gap_s:.3f} s from the first frame and never meet the frames"
        raise LogError(what, file=table, remedy="give the samples on the clock of the frames", reason="times.other_clock")
    stated = sidecar.T_cam_imu
    T_cam_imu = np.array(stated) if stated is not None else rig.T_rect_body @ read_asl_settings(calibration).motion("T_BS")
    left_out = (f"{stale} samples of imu0 whose time stamp is not after the one before",) if stale else ()
    files = (*found.files, table, *([calibration] if calibration.is_file() else []))
    return replace(found, imu=track, T_cam_imu=T_cam_imu, missing=(*without, *left_out), files=files)


def read_truth(body: Path, rig: EurocRig, t_ns: NDArray[np.int64]) -> tuple[FloatArray | None, list[Path]]:
    """(N, 4, 4) T_world_cam of the rectified left camera, NaN where there is none, and the files that were read."""
    folder = next((body / name for name in TRUTHS if (body / name / "data.csv").is_file()), None)
    if folder is None:
        return None, []
    files = [folder / "data.csv", *([folder / "sensor.yaml"] if (folder / "sensor.yaml").is_file() else [])]
    T_body_sensor = read_asl_settings(files[1]).motion("T_BS") if len(files) > 1 else np.eye(4)
    stamps, T_world_sensor = read_poses(files[0])
    T_sensor_cam = se3.inverse(T_body_sensor) @ se3.inverse(rig.T_rect_body)
    truth = np.asarray(poses_at(t_ns, stamps, T_world_sensor) @ T_sensor_cam)
    return (truth if np.isfinite(truth).any() else None), files
