"""What the writers of both KITTI layouts share: a folder that appears only when the drive is whole."""

import shutil
import tempfile
from abc import ABC, abstractmethod
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from wayloom.errors import LogError
from wayloom.geometry.camera import StereoRig
from wayloom.logs.oxts_writer import OxtsPacket, OxtsWriter
from wayloom.logs.sidecar import SIDECAR_NAME, Sidecar
from wayloom.logs.trajectory_files import write_kitti
from wayloom.logs.types import Image, StereoFrame

FloatArray = NDArray[np.float64]


class DriveWriter(ABC):
    """Streams a drive into a folder. Use it as a context manager: the drive takes its place at the end, or not at all.

    folder       where to write while the drive is not whole (a hidden folder beside `path`); anything put there moves with it
    path         where the drive will be; must not exist, or be an empty folder
    colour       whether frames are RGB
    p_cam_gnss   (3,) m, T_cam_imu (4, 4): as in `DriveLog`, where known
    """

    name_digits: int

    def __init__(
        self,
        path: Path,
        rig: StereoRig,
        *,
        colour: bool = True,
        rig_id: str | None = None,
        vehicle_id: str | None = None,
        p_cam_gnss: FloatArray | None = None,
        T_cam_imu: FloatArray | None = None,
    ) -> None:
        if path.exists() and (not path.is_dir() or any(path.iterdir())):
            raise LogError("exists and is no empty folder", file=path, remedy="remove it or give another path")
        self.path, self.rig, self.colour, self.T_cam_imu = path, rig, colour, T_cam_imu
        self.times_ns: list[int] = []
        self._truth: list[FloatArray] = []
        self._oxts: OxtsWriter | None = None
        self._sidecar = Sidecar(
            rig_id=rig_id,
            vehicle_id=vehicle_id,
            p_cam_gnss_m=None if p_cam_gnss is None else tuple(p_cam_gnss.tolist()),
            T_cam_imu=None if T_cam_imu is None else tuple(tuple(row) for row in T_cam_imu.tolist()),
        )
        path.parent.mkdir(parents=True, exist_ok=True)
        self.folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
        self.folder.chmod(0o755)
        for folder in self.image_folders():
            folder.mkdir(parents=True)

    @abstractmethod
    def image_folders(self) -> tuple[Path, Path]:
        """Left and right."""

    @abstractmethod
    def write_calibration(self) -> None:
        """Write what the reader needs to know of the cameras."""

    @abstractmethod
    def write_times(self) -> None:
        """Write the frames' time stamps."""

    def add(self, frame: StereoFrame, T_world_cam: FloatArray | None = None) -> None:
        """Write the next frame as PNG and keep its true pose (4, 4), which all frames have or none.

        Raises LogError where the frame does not follow the one before, or is not as the rig says.
        """
        camera = self.rig.camera
        shape = (camera.height, camera.width, 3) if self.colour else (camera.height, camera.width)
        if frame.left.shape != shape or frame.right.shape != shape:
            raise LogError(f"frame {frame.index} is {frame.left.shape}, the rig's images are {shape}", file=self.path)
        if self.times_ns and frame.t_ns <= self.times_ns[-1]:
            raise LogError(f"frame {frame.index} is not after the one before it", file=self.path)
        name = f"{len(self.times_ns):0{self.name_digits}d}.png"
        for folder, image in zip(self.image_folders(), (frame.left, frame.right), strict=True):
            (folder / name).write_bytes(_png(image))
        self.times_ns.append(frame.t_ns)
        if T_world_cam is not None:
            self._truth.append(T_world_cam)

    def add_gnss(self, packet: OxtsPacket) -> None:
        """Write the next packet of the GNSS/INS unit."""
        if self._oxts is None:
            self._oxts = OxtsWriter(self.folder / "oxts")
        self._oxts.add(packet)

    def finish(self) -> Path:
        """Write the small files and put the drive in its place. Raises LogError where it has no frame, or poses for some only."""
        if not self.times_ns or len(self._truth) not in (0, len(self.times_ns)):
            what = f"{len(self.times_ns)} frames with {len(self._truth)} poses are no drive"
            raise LogError(what, file=self.path, remedy="add at least one frame, and a pose for all or none")
        self.write_calibration()
        self.write_times()
        if self._truth:
            write_kitti(self.folder / "poses.txt", np.array(self._truth))
        if self._oxts is not None:
            self._oxts.finish()
        (self.folder / SIDECAR_NAME).write_text(self._sidecar.model_dump_json(indent=2) + "\n", encoding="utf-8")
        self.folder.replace(self.path)
        return self.path

    def discard(self) -> None:
        """Leave nothing behind."""
        shutil.rmtree(self.folder, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        try:
            if kind is None:
                self.finish()
        finally:
            self.discard()


def numbers_text(values: FloatArray) -> str:
    """Numbers, rows first, that are read back exactly."""
    return " ".join(repr(float(value)) for value in values.ravel())


def projection_texts(rig: StereoRig) -> tuple[str, str]:
    """P = K [I | t] of the left and the right camera, as KITTI's files have it."""
    K = rig.camera.K
    left, right = (np.column_stack([K, K @ np.array(t)]) for t in ((0.0, 0.0, 0.0), rig.t_right_left))
    return numbers_text(left), numbers_text(right)


def _png(image: Image) -> bytes:
    return bytes(cv2.imencode(".png", image[..., ::-1] if image.ndim == 3 else image)[1])
