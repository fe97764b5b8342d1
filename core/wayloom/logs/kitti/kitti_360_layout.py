"""KITTI-360 folder layout: one root with a folder for each kind of data, most with one folder for each sequence."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wayloom.errors import LogError, UnknownFormatError

RAW_2D: Final = "data_2d_raw"
CAMERAS: Final = ("image_00", "image_01")
SCAN_FOLDER: Final = "velodyne_points"
SHOWN = 5


@dataclass(frozen=True, slots=True)
class Sequence:
    """One sequence: the dataset's root, and the sequence's name."""

    root: Path
    name: str

    @property
    def images(self) -> Path:
        """Holds image_00 and image_01, each with data_rect and timestamps.txt."""
        return self.root / RAW_2D / self.name

    @property
    def poses(self) -> Path:
        """Holds poses.txt, cam0_to_world.txt and oxts."""
        return self.root / "data_poses" / self.name

    @property
    def scans(self) -> Path:
        """Holds velodyne_points."""
        return self.root / "data_3d_raw" / self.name

    @property
    def label_images(self) -> Path:
        """Holds image_00 and image_01, each with semantic and instance."""
        return self.root / "data_2d_semantics" / "train" / self.name

    @property
    def clouds(self) -> Path:
        """Holds static and dynamic."""
        return self.root / "data_3d_semantics" / "train" / self.name

    def calibration(self, name: str) -> Path:
        """A calibration file."""
        return self.root / "calibration" / name

    def scan(self, frame: int) -> Path:
        """The scan of a frame."""
        return self.scans / SCAN_FOLDER / "data" / f"{frame:010d}.bin"

    def label_image(self, kind: str, frame: int, camera: int) -> Path:
        """The `semantic` or `instance` image of a frame."""
        return self.label_images / CAMERAS[camera] / kind / f"{frame:010d}.png"


def is_root(path: Path) -> bool:
    """Whether a folder holds the dataset."""
    return (path / RAW_2D).is_dir()


def is_sequence(path: Path) -> bool:
    """Whether a folder is one of data_2d_raw."""
    return any((path / camera / "data_rect").is_dir() for camera in CAMERAS)


def sequences(root: Path) -> list[Sequence]:
    """The sequences of a root, by name."""
    return [Sequence(root, folder.name) for folder in sorted((root / RAW_2D).iterdir()) if folder.is_dir()]


def find_sequence(path: Path) -> Sequence:
    """The sequence whose folder `path` is, or the only one of the root `path`. Raises LogError or UnknownFormatError."""
    if not is_root(path):
        return Sequence(path.parent.parent, path.name)
    found = sequences(path)
    if len(found) == 1:
        return found[0]
    if not found:
        raise LogError("holds no sequence", file=path / RAW_2D, remedy="put the images of a sequence there")
    names = ", ".join(sequence.name for sequence in found[:SHOWN]) + (", …" if len(found) > SHOWN else "")
    what = f"holds {len(found)} sequences ({names})"
    raise UnknownFormatError(what, file=path, remedy=f"give the folder of one of them below {path / RAW_2D}")


def find_sequences(path: Path) -> list[Sequence]:
    """All sequences below `path`: a sequence's folder, a root, or a folder of roots. Raises UnknownFormatError."""
    if is_sequence(path):
        return [find_sequence(path)]
    roots = [path] if is_root(path) else [folder for folder in sorted(path.iterdir()) if is_root(folder)] if path.is_dir() else []
    found = [sequence for root in roots for sequence in sequences(root)]
    if not found:
        what = f"no KITTI-360 data: looked for {RAW_2D} in it and one level below"
        raise UnknownFormatError(what, file=path, remedy="give KITTI-360's root, or a folder of such roots")
    return found
