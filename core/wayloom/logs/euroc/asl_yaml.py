"""`sensor.yaml` of the ASL data set format: the small part of YAML that it is written in.

`key: value` lines, one level of nested keys, flow lists `[1, 2]` over any number of lines, comments, quotes. Anchors, tags with
content, block lists and everything else of YAML are not read, so that no file can unpack to more than it holds.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import CalibrationError
from wayloom.files.text_files import parse_numbers, quoted, read_text

FloatArray = NDArray[np.float64]
RESTORE: Final = "give the sensor.yaml of the ASL data set format"
MOST_CHARACTERS: Final = 1 << 20
_KEY: Final = re.compile(r"^(\s*)([A-Za-z_][\w .-]*?)\s*:(?:\s+(.*))?$")


@dataclass(frozen=True, slots=True)
class AslSettings:
    """The entries of a sensor.yaml by key, a nested one as `T_BS.data`; texts, which are parsed when they are asked for.

    A list over several lines keeps them, and `lines` has the number of its first one.
    """

    file: Path
    entries: dict[str, str]
    lines: dict[str, int]

    def __contains__(self, key: str) -> bool:
        return key in self.entries

    def text(self, key: str) -> str:
        """The text of a key. Raises CalibrationError where it is missing."""
        if key not in self.entries:
            raise CalibrationError("is missing", file=self.file, record=key, remedy=RESTORE)
        return self.entries[key].strip().strip("'\"")

    def numbers(self, key: str) -> FloatArray:
        """The finite numbers of a list (n,). Raises CalibrationError naming key and line."""
        rows = enumerate(self.text(key).strip("[]").replace(",", " ").split("\n"), start=self.lines[key])
        parsed = [parse_numbers(row, file=self.file, record=f"{key}, line {line}", error=CalibrationError) for line, row in rows]
        return np.concatenate(parsed)

    def motion(self, key: str) -> FloatArray:
        """The (4, 4) rigid motion under `key`.data. Raises CalibrationError where it is none (to 1e-3)."""
        record = f"{key}.data"
        values = self.numbers(record)
        if len(values) not in (12, 16):
            what = f"{len(values)} numbers where 16 belong"
            raise CalibrationError(what, file=self.file, record=record, remedy=RESTORE)
        T = np.vstack([values[:12].reshape(3, 4), (0.0, 0.0, 0.0, 1.0)])
        last = values[12:] if len(values) == 16 else T[3]
        R = T[:3, :3]
        if not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0 and np.allclose(last, T[3])):
            raise CalibrationError("is no rigid motion", file=self.file, record=record, remedy=RESTORE)
        T[:3, :3] = _rotation_near(R)
        return T


def read_asl_settings(file: Path) -> AslSettings:
    """Raises CalibrationError where the file is missing, or is no such text."""
    text = read_text(file, remedy=RESTORE, error=CalibrationError)
    if len(text) > MOST_CHARACTERS:
        raise CalibrationError(f"{len(text)} characters are no calibration", file=file, remedy=RESTORE)
    entries: dict[str, str] = {}
    lines: dict[str, int] = {}
    parent, key, is_open = "", "", False
    for number, line in enumerate(text.split("\n"), start=1):
        content = line.split("#", 1)[0].rstrip()
        if not content.strip() or content.startswith(("%", "---", "...")):
            if is_open:
                entries[key] += "\n"
            continue
        if is_open:
            entries[key] += "\n" + content.strip()
        elif (match := _KEY.match(content)) is not None:
            indent, name, value = match.groups()
            parent = parent if indent else name
            key = f"{parent}.{name}" if indent else name
            entries[key], lines[key] = (value or "").strip(), number
        else:
            what = f"{quoted(content.strip())} is not understood"
            raise CalibrationError(what, file=file, record=f"line {number}", remedy=RESTORE)
        is_open = entries[key].count("[") > entries[key].count("]")
    if is_open:
        raise CalibrationError(
            "the list is not closed", file=file, record=key, remedy="the file is cut: copy it again", reason="file.cut"
        )
    return AslSettings(file, entries, lines)


def _rotation_near(R: FloatArray) -> FloatArray:
    """The rotation (3, 3) nearest to R: files give eight or more decimals. One that is exact already stays as it is."""
    if np.abs(R @ R.T - np.eye(3)).max() < 1e-14:
        return R
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)
