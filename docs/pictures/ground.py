"""Makes docs/pictures/ground.jpg: `python docs/pictures/ground.py OUT NUMBER`, of the sheet NUMBER of a processed drive.

Left the orthophoto, right the height over the surroundings (blue is 10 cm lower, red 10 cm higher) of what is 30 m around.
"""

import sys
from pathlib import Path

import cv2
import numpy as np

from wayloom.ground.files import load_sheet, read_index

TARGET = Path(__file__).parent / "ground.jpg"
WIDTH_M, SPAN_M, AROUND_M = 44.0, 0.1, 3.0


def main(out: Path, number: int) -> None:
    """Cut the square of most cells out of the sheet and draw it."""
    folder = out / "stages" / "ground"
    folder = folder if folder.is_dir() else out
    sheet = load_sheet(folder, list(read_index(folder).values())[number])
    height = sheet.height
    known = np.isfinite(height).astype(np.float32)
    side = min(round(WIDTH_M / 0.1), *height.shape)
    filled = cv2.boxFilter(known, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
    row, column = np.unravel_index(int(filled.argmax()), filled.shape)
    r, c = (int(np.clip(at - side // 2, 0, n - side)) for at, n in zip((row, column), height.shape, strict=True))
    around = AROUND_M / 0.1
    mean = cv2.GaussianBlur(np.nan_to_num(height).astype(np.float32), (0, 0), around) / np.maximum(
        cv2.GaussianBlur(known, (0, 0), around), 1e-6
    )
    tone = np.clip((height - mean) / SPAN_M * 127.0 + 128.0, 0, 255)
    colours = cv2.applyColorMap(np.nan_to_num(tone).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[known == 0] = 255
    colour = sheet.colour if sheet.colour.shape[2] == 3 else sheet.colour.repeat(3, axis=2)
    photo = np.where(sheet.sharpness[..., None] > 0, colour, 255)[..., ::-1].astype(np.uint8)
    left, right = photo[2 * r : 2 * (r + side), 2 * c : 2 * (c + side)], colours[r : r + side, c : c + side]
    right = cv2.resize(right, left.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    both = np.concatenate([left[::-1], np.full((left.shape[0], 12, 3), 255, np.uint8), right[::-1]], axis=1)
    cv2.imwrite(str(TARGET), cv2.resize(both, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA), [cv2.IMWRITE_JPEG_QUALITY, 85])


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]))
