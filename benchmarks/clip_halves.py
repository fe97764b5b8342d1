"""Two drives made of one KITTI recording: the even frames of its first part and the odd ones of its last, half in common.

The first keeps its RTK fixes, the second gets those of a receiver without corrections: metres off, and slowly wandering.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.logs.sidecars.oxts import Field, read_packet

FloatArray = NDArray[np.float64]
DRIVE = "2011_10_03_drive_0027_sync"
OFFSET_ENU_M, SIGMA_M, WANDER_M, WANDER_S = (2.4, -1.7, 3.1), 3.0, 1.0, 20.0
METRES_A_DEGREE = 111_194.9
SINGLE = 3


def frames_of(half: str, count: int = 201) -> list[int]:
    """Frames of the recording: even ones of its first three quarters, or odd ones of its last three."""
    return list(range(0, 3 * count // 4, 2)) if half == "even" else list(range(count // 4 + 1, count, 2))


def make_half(data: Path, out: Path, half: str) -> tuple[Path, Path]:
    """The log and the GNSS folder of one half, below `out`; images are links."""
    source, oxts = data / "kitti_odometry" / "sequences" / "00", data / "kitti_oxts" / "2011_10_03"
    log, packets = out / half / "log", out / half / "2011_10_03" / DRIVE / "oxts"
    frames = frames_of(half)
    for folder in (log / "image_0", log / "image_1", packets / "data"):
        folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames):
        for camera in ("image_0", "image_1"):
            link = log / camera / f"{number:06d}.png"
            if not link.is_symlink():
                link.symlink_to((source / camera / f"{frame:06d}.png").resolve())
    (log / "calib.txt").write_text((source / "calib.txt").read_text())
    times = (source / "times.txt").read_text().splitlines()
    (log / "times.txt").write_text("\n".join(times[frame] for frame in frames) + "\n")
    for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt"):
        (packets.parents[1] / name).write_text((oxts / name).read_text())
    stamps = (oxts / DRIVE / "oxts" / "timestamps.txt").read_text().splitlines()
    (packets / "timestamps.txt").write_text("\n".join(stamps[frame] for frame in frames) + "\n")
    errors = np.zeros((len(frames), 3)) if half == "even" else single_point_errors(0.1 * np.array(frames))
    for number, frame in enumerate(frames):
        values = read_packet(oxts / DRIVE / "oxts" / "data" / f"{frame:010d}.txt")
        text = packet_text(values, errors[number], degraded=half == "odd")
        (packets / "data" / f"{number:010d}.txt").write_text(text)
    return log, packets.parent


def single_point_errors(t_s: FloatArray) -> FloatArray:
    """(N, 3) m east, north, up: an offset and a Gauss-Markov wander about it."""
    rng = np.random.default_rng(0)
    out = np.empty((len(t_s), 3))
    out[0] = rng.normal(0.0, WANDER_M, 3)
    for k in range(1, len(t_s)):
        keep = np.exp(-(t_s[k] - t_s[k - 1]) / WANDER_S)
        out[k] = keep * out[k - 1] + np.sqrt(1.0 - keep**2) * rng.normal(0.0, WANDER_M, 3)
    return out + np.array(OFFSET_ENU_M)


def packet_text(values: FloatArray, error_enu: FloatArray, degraded: bool) -> str:
    """The packet's 30 numbers, its place moved by error_enu (3,) m."""
    values = values.copy()
    values[Field.LAT] += error_enu[1] / METRES_A_DEGREE
    values[Field.LON] += error_enu[0] / METRES_A_DEGREE / np.cos(np.deg2rad(values[Field.LAT]))
    values[Field.ALT] += error_enu[2]
    if degraded:
        values[Field.POS_ACCURACY], values[Field.POSMODE] = SIGMA_M, SINGLE
    whole = range(Field.NAVSTAT, len(Field))
    return " ".join(str(int(v)) if k in whole else repr(float(v)) for k, v in enumerate(values)) + "\n"


def truth_of(data: Path, half: str) -> FloatArray:
    """(N, 4, 4) T_start_cam of the half's frames by the recording's poses."""
    numbers = np.loadtxt(data / "kitti_odometry" / "poses" / "00.txt")[frames_of(half)]
    return se3.from_rotation_translation(numbers.reshape(-1, 3, 4)[:, :, :3], numbers.reshape(-1, 3, 4)[:, :, 3])
