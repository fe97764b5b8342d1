"""Time and bytes of deflate by zlib and by ISA-L, of a drive's sheets of ground and of the tiles of its GeoTIFFs.

    python benchmarks/packing.py OUT

OUT  what `wayloom process` left. Times and bytes are those of zlib's level 6, one run each on one core.
"""

import argparse
import time
import zlib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Final

import cv2
import numpy as np
from isal import isal_zlib

from wayloom.files.geotiff import TILE
from wayloom.ground.sheet import RASTERS, decode_sheet

PACKERS: Final = {
    "zlib 6": (zlib, 6), "zlib 4": (zlib, 4), "zlib 1": (zlib, 1),
    "ISA-L 3": (isal_zlib, 3), "ISA-L 2": (isal_zlib, 2), "ISA-L 1": (isal_zlib, 1),
}  # fmt: skip


def main() -> None:
    """Print a table for the sheets and one for the tiles."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    out = parser.parse_args().out
    for name, streams in (("sheets", list(of_sheets(out))), ("tiles", list(of_tiles(out)))):
        print(f"| {name}, {sum(map(len, streams)) / 1e6:.1f} MB | time to pack | bytes | time to unpack |")
        print("| --- | --- | --- | --- |")
        measured = {packer: measure(module, level, streams) for packer, (module, level) in PACKERS.items()}
        packing, size, unpacking = measured["zlib 6"]
        for packer, (seconds, kept, back) in measured.items():
            print(f"| {packer} | {seconds / packing:.3f} | {kept / size:.3f} | {back / unpacking:.2f} |")
        print()


def measure(module: ModuleType, level: int, streams: list[bytes]) -> tuple[float, int, float]:
    """Seconds of packing, bytes, seconds of unpacking."""
    start = time.process_time()
    packed = [module.compress(one, level) for one in streams]
    between = time.process_time()
    for one in packed:
        module.decompress(one)
    return between - start, sum(map(len, packed)), time.process_time() - between


def of_sheets(out: Path) -> Iterator[bytes]:
    """Differences along the rows, as `wayloom.ground.packing` packs them."""
    for file in sorted((out / "stages" / "ground").glob("*.ground")):
        sheet = decode_sheet(file.read_bytes(), str(file))
        for name, dtype in RASTERS.items():
            yield differences(getattr(sheet, name).astype(dtype))


def of_tiles(out: Path) -> Iterator[bytes]:
    """Tiles of the full image that show something, as `wayloom.files.geotiff` packs them."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # it warns of GeoTIFF's tags
    for name in ("ground.tif", "height.tif"):
        picture = cv2.imread(str(out / name), cv2.IMREAD_UNCHANGED)
        if picture is None:
            raise SystemExit(f"{out / name} is missing: give the folder that `wayloom process` wrote")
        for row in range(0, picture.shape[0], TILE):
            for column in range(0, picture.shape[1], TILE):
                tile = picture[row : row + TILE, column : column + TILE]
                if tile.any() and not np.isnan(tile).all():
                    yield differences(tile) if tile.dtype == np.uint8 else tile.astype("<f4").tobytes()


def differences(raster: np.ndarray) -> bytes:
    """Of each value and the one to its west."""
    return np.concatenate([raster[:, :1], raster[:, 1:] - raster[:, :-1]], axis=1).tobytes()


if __name__ == "__main__":
    main()
