"""A short real log and a network that costs nothing, for tests of the whole way."""

import shutil
from pathlib import Path

import numpy as np

from segmentation.made_network import THREE, logits_network, put

FRAMES = 40


def first_frames(clip: Path, folder: Path, frames: int = FRAMES) -> Path:
    """The first frames of a KITTI odometry sequence, copied."""
    for side in ("image_0", "image_1"):
        (folder / side).mkdir(parents=True)
        for i in range(frames):
            shutil.copyfile(clip / side / f"{i:06d}.png", folder / side / f"{i:06d}.png")
    shutil.copyfile(clip / "calib.txt", folder / "calib.txt")
    times = (clip / "times.txt").read_text().splitlines()[:frames]
    (folder / "times.txt").write_text("\n".join(times) + "\n")
    return folder


def colour_network(folder: Path, name: str = "colours", classes: str = THREE) -> Path:
    """A network whose three classes are the colours; on grey images the first one wins."""
    folder.mkdir(exist_ok=True)
    return put(folder, name, logits_network(), classes)


def damage(image: Path) -> None:
    """Blank a part of the file, but leave it the ends that a quick look checks."""
    data = np.fromfile(image, np.uint8)
    data[len(data) // 3 : len(data) // 2] = 0
    data.tofile(image)
