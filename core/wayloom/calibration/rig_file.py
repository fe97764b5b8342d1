"""The rig file `RIG.toml`: a rig's relative lens and its normal equations. docs/formats.md describes every key."""

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wayloom.calibration.receiver import STATES, ReceiverEvidence, learnt_receiver
from wayloom.calibration.score_moments import COUNT, SIZE, ScoreMoments
from wayloom.config.toml_text import toml_text
from wayloom.errors import CalibrationError
from wayloom.files.atomic import write_atomically
from wayloom.files.text_files import read_text
from wayloom.geometry.camera import PinholeCamera, StereoRig
from wayloom.geometry.lens import PARAMETERS, RightLens, lens_from_values
from wayloom.logs.types import DriveLog

FloatArray = NDArray[np.float64]
VERSION: Final = 2
WITHOUT_SCORES: Final = 1
"""Files of this version give their lens; drives cannot be added to them."""
SAID: Final = COUNT + 1
"""What drives speak of: the parameters, and a radial error k1 that both lenses share."""
SAME_RIG, SAME_CALIBRATION = 0.05, 1e-3
"""Relative differences of focal length, baseline and size: above the first it is another rig, above the second
another calibration of it."""
LARGEST: Final = np.array([0.1, 0.1, 0.1, 0.2, 0.2, 0.2, 100.0, 1.0, 0.2, 0.2])
"""How far a parameter may be from the ideal camera's before a file counts as damaged."""
REMEDY: Final = "restore the file, or learn it again with `wayloom calibrate`"


@dataclass(frozen=True, slots=True)
class RigFile:
    """A rig as learnt.

    rig_id       None where the drives did not name it
    rig          the rectified rig that the lens is relative to: the calibration of the first drive
    drives       names of the drives that it was learnt from, sorted
    lens, sigma, determined   the parameters; (10,) standard deviations; (10,) whether the drives determined them
    information, pull   (11, 11) and (11,): the drives' normal equations without any prior, energy 1/2 x^T information x - pull^T x
                 of the parameters' difference from the ideal camera's and a radial error k1 of both lenses; later drives are added
    scores       moments of the match groups' scores, for the sigmas; None in a file of format 1; those of later drives are added
    matches, noise_px   how many matches it rests on, and how well one fits, px
    baseline_ratio   true baseline over the given one, as far as drives with GNSS know it (`scales` of them)
    covariance   (11, 11) of lens and log baseline ratio; None in a file of `wayloom calibrate`
    bias_sigma_px how much the disparity bias differs from drive to drive, where the drives tell
    receivers    what each of the rig's drives tells of GNSS clock and lever arm, by the time of recording; of all its epochs
    """

    rig_id: str | None
    rig: StereoRig
    drives: tuple[str, ...]
    lens: RightLens
    sigma: FloatArray
    determined: NDArray[np.bool_]
    information: FloatArray = field(default_factory=lambda: np.zeros((SAID, SAID)))
    pull: FloatArray = field(default_factory=lambda: np.zeros(SAID))
    scores: ScoreMoments | None = field(default_factory=ScoreMoments)
    matches: int = 0
    noise_px: float = 0.0
    baseline_ratio: float = 1.0
    covariance: FloatArray | None = None
    scales: int = 0
    bias_sigma_px: float | None = None
    receivers: tuple[ReceiverEvidence, ...] = ()


def write_rig_file(rig: RigFile, file: Path) -> None:
    """Write `file`, whole or not at all."""
    write_atomically(file, text_of(rig).encode())


def read_rig_file(file: Path) -> RigFile:
    """Raises CalibrationError naming the key that is missing, of the wrong kind or impossible."""
    return rig_from_text(read_text(file, remedy=REMEDY, error=CalibrationError), file)


def rig_from_text(text: str, file: Path) -> RigFile:
    """As `read_rig_file`, of the text of a file that errors name."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise CalibrationError(f"is no TOML ({problem})", file=file, remedy=REMEDY) from None
    version = content.get("format_version")
    if version not in (WITHOUT_SCORES, VERSION):
        raise CalibrationError(f"has format_version {version!r}, not {VERSION}", file=file, remedy=REMEDY)
    return _Reader(file, content).rig_file(version)


def differences(rig: RigFile, log_rig: StereoRig, rig_id: str | None, *, file: Path | str) -> tuple[str, ...]:
    """What makes the rig file doubtful for a log with this calibration and rig_id, in words.

    Raises CalibrationError where it is another rig's: another rig_id, or focal length, baseline or size more than 5 % away.
    """
    if rig.rig_id is not None and rig_id is not None and rig.rig_id != rig_id:
        raise CalibrationError(
            f"is of the rig {rig.rig_id}, the log of {rig_id}",
            file=file,
            record="rig_id",
            remedy="give the file of the log's own rig",
        )
    worst, what = max((abs(b / a - 1.0), name) for name, a, b in _numbers(rig.rig, log_rig))
    if worst > SAME_RIG:
        raise CalibrationError(
            f"is of a rig whose {what} differs by {100 * worst:.1f} % from the log's",
            file=file, record=what, remedy="give the file of the log's own rig",
        )  # fmt: skip
    doubts = []
    if (rig.rig_id is None) != (rig_id is None):
        doubts.append(f"the rig file says rig {rig.rig_id or 'unknown'}, the log {rig_id or 'unknown'}")
    if worst > SAME_CALIBRATION:
        doubts.append(f"the rig file was learnt with another calibration ({what} differs by {100 * worst:.2f} %)")
    return tuple(doubts)


def lens_for_log(path: Path | None, log: DriveLog) -> tuple[RightLens | None, tuple[str, ...]]:
    """The lens of a log's rig, and doubts about it in words; None where nothing is known. As `rig_for_log`."""
    rig, doubts = rig_for_log(path, log)
    return None if rig is None else rig.lens, doubts


def rig_for_log(path: Path | None, log: DriveLog) -> tuple[RigFile | None, tuple[str, ...]]:
    """What is known of a log's rig, and doubts about it in words; None where nothing is known.

    path : a rig file, or a folder that holds one named `<rig_id>.toml` for each rig that is known, or None
    Raises CalibrationError where the file cannot be used for this log.
    """
    file = path
    if path is not None and path.is_dir():
        file = None if log.rig_id is None else path / f"{log.rig_id}.toml"
        file = file if file is not None and file.exists() else None
    if file is None:
        return None, ()
    rig = read_rig_file(file)
    return rig, differences(rig, log.rig, log.rig_id, file=file)


def _numbers(a: StereoRig, b: StereoRig) -> list[tuple[str, float, float]]:
    """Name and values of what must be the same in both rigs; lengths in px relative to the image's width."""
    values = [("baseline", a.baseline_m, b.baseline_m)]
    values += [(name, getattr(a.camera, name), getattr(b.camera, name)) for name in ("fx", "fy", "width", "height")]
    return values


def text_of(rig: RigFile) -> str:
    """The file's text; numbers keep all their digits."""
    camera = rig.rig.camera
    lines = [
        "# A stereo rig's relative lens, by `wayloom calibrate`: from the ideal rectified right camera's pixel to the real one's.",
        f"format_version = {VERSION}",
        *([] if rig.rig_id is None else [f"rig_id = {toml_text(rig.rig_id)}"]),
        f"drives = {toml_text(rig.drives)}",
        f"matches = {rig.matches}",
        f"noise_px = {rig.noise_px!r}",
        "",
        "[camera]",
        *(f"{name} = {float(getattr(camera, name))!r}" for name in ("fx", "fy", "cx", "cy")),
        f"width = {camera.width}",
        f"height = {camera.height}",
        f"t_right_left_m = {_row(np.array(rig.rig.t_right_left))}",
        "",
        "[right_lens]",
        *(f"{name} = {float(getattr(rig.lens, name))!r}" for name in PARAMETERS),
        "",
        "[right_lens.sigma]",
        *(f"{name} = {float(sigma)!r}" for name, sigma in zip(PARAMETERS, rig.sigma, strict=True)),
        "",
        "[right_lens.determined]",
        *(f"{name} = {str(bool(known)).lower()}" for name, known in zip(PARAMETERS, rig.determined, strict=True)),
        "",
        "# What the drives say without any prior, of the lens's difference from the ideal one and a radial error of both.",
        "[normal_equations]",
        f"pull = {_row(rig.pull)}",
        "information = [",
        *(f"  {_row(row)}," for row in rig.information),
        "]",
        *_scale_lines(rig),
        *_score_lines(rig.scores or ScoreMoments()),
        *_receiver_lines(rig.receivers),
    ]
    return "\n".join(lines) + "\n"


def _scale_lines(rig: RigFile) -> list[str]:
    if rig.covariance is None:
        return []
    return [
        "",
        "# The true baseline over the given one, and the covariance of lens and log of that ratio (the lower triangle).",
        "[scale]",
        f"drives_with_gnss = {rig.scales}",
        f"baseline_ratio = {rig.baseline_ratio!r}",
        *([] if rig.bias_sigma_px is None else [f"bias_sigma_px = {rig.bias_sigma_px!r}"]),
        "covariance = [",
        *(f"  {_row(row[: k + 1])}," for k, row in enumerate(rig.covariance)),
        "]",
    ]


def _score_lines(scores: ScoreMoments) -> list[str]:
    return [
        "",
        "# Of the match groups' scores: moments (the lower triangle), and errors that regions of the image share.",
        "[scores]",
        f"region_excess_px2 = {scores.region_excess_px2!r}",
        f"region_freedom = {scores.region_freedom!r}",
        "moments = [",
        *(f"  {_row(row[: k + 1])}," for k, row in enumerate(scores.moments)),
        "]",
    ]


def _receiver_lines(receivers: Sequence[ReceiverEvidence]) -> list[str]:
    """Each drive's part; what they come to, for people, stands in a comment."""
    learnt = learnt_receiver(receivers)
    if learnt is None:
        return []
    sigma = np.sqrt(np.diag(learnt.covariance))
    lines = [
        "",
        f"# The GNSS clock by the newest epoch's drives: {1e3 * learnt.mean[0]:+.1f} ms late, sigma {1e3 * sigma[0]:.1f} ms "
        "where the lever arm is not given.",
        "# What each drive tells of (time offset in s, antenna in the left camera's frame in m), without any prior.",
    ]
    for one in sorted(receivers, key=lambda one: (one.t_ns, one.drive_id)):
        lines += ["[[receiver]]", f"drive = {toml_text(one.drive_id)}", f"t_ns = {one.t_ns}", f"pull = {_row(one.pull)}"]
        lines += ["information = [", *(f"  {_row(row)}," for row in one.information), "]"]
    return lines


def _row(values: FloatArray) -> str:
    return f"[{', '.join(repr(float(value)) for value in values)}]"


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


@dataclass(frozen=True, slots=True)
class _Reader:
    """Takes a file's content apart, each key with its check."""

    file: Path
    content: Mapping[str, Any]

    def rig_file(self, version: int) -> RigFile:
        values = self._ten("right_lens")
        offsets = np.abs(values - RightLens().values)
        if (offsets > LARGEST).any():
            name = PARAMETERS[int(np.argmax(offsets / LARGEST))]
            raise self._bad(f"right_lens.{name}", "is impossible for a rectified pair")
        equations = "evidence" if version == WITHOUT_SCORES else "normal_equations"
        information = self._matrix(f"{equations}.information", SAID)
        pull = self._floats(f"{equations}.pull", SAID)
        sigma = self._ten("right_lens.sigma")
        if (sigma < 0).any():
            raise self._bad("right_lens.sigma", "is negative")
        return RigFile(
            self._rig_id(), self._rig(), self._drives(), lens_from_values(values), sigma, self._determined(), information, pull,
            None if version == WITHOUT_SCORES else self._scores(), int(self._number("matches", 0.0)), self._number("noise_px", 0.0),
            *self._scale(), self._receivers(),
        )  # fmt: skip

    def _get(self, key: str) -> Any:
        value: Any = self.content
        for part in key.split("."):
            if not isinstance(value, Mapping) or part not in value:
                raise self._bad(key, "is missing")
            value = value[part]
        return value

    def _number(self, key: str, low: float = -math.inf) -> float:
        value = self._get(key)
        if not _is_number(value) or value < low:
            raise self._bad(key, f"{value!r} is no number{'' if low == -math.inf else f' from {low:g} on'}")
        return float(value)

    def _floats(self, key: str, count: int) -> FloatArray:
        value = self._get(key)
        if not isinstance(value, list) or len(value) != count:
            raise self._bad(key, f"must be {count} numbers")
        if not all(_is_number(x) for x in value):
            raise self._bad(key, "holds what is no finite number")
        return np.array(value, float)

    def _ten(self, table: str) -> FloatArray:
        return np.array([self._number(f"{table}.{name}") for name in PARAMETERS])

    def _matrix(self, key: str, size: int) -> FloatArray:
        matrix = np.array(self._rows(key, [size] * size), float).reshape(size, size)
        if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-6 * np.abs(matrix).max()):
            raise self._bad(key, f"is no symmetric matrix of {size} rows and columns")
        return matrix

    def _triangle(self, key: str, size: int) -> FloatArray:
        """A symmetric matrix, of its lower triangle."""
        matrix = np.zeros((size, size))
        matrix[np.tril_indices(size)] = np.concatenate(self._rows(key, range(1, size + 1)))
        return np.asarray(matrix + np.tril(matrix, -1).T)

    def _rows(self, key: str, lengths: Sequence[int]) -> list[FloatArray]:
        rows = self._get(key)
        if not isinstance(rows, list) or [len(row) if isinstance(row, list) else -1 for row in rows] != list(lengths):
            raise self._bad(key, f"must be {len(lengths)} rows of {lengths[0]} to {lengths[-1]} numbers")
        if not all(_is_number(x) for row in rows for x in row):
            raise self._bad(key, "holds what is no finite number")
        return [np.array(row, float) for row in rows]

    def _scores(self) -> ScoreMoments:
        scores = ScoreMoments(
            self._triangle("scores.moments", SIZE),
            self._number("scores.region_excess_px2"), self._number("scores.region_freedom", 0.0),
        )  # fmt: skip
        if (np.diag(scores.moments) < 0).any():
            raise self._bad("scores.moments", "has a negative sum of squares")
        return scores

    def _scale(self) -> tuple[float, FloatArray | None, int, float | None]:
        if "scale" not in self.content:
            return 1.0, None, 0, None
        ratio, covariance = self._number("scale.baseline_ratio"), self._triangle("scale.covariance", SAID)
        if not abs(ratio - 1.0) <= SAME_RIG:
            raise self._bad("scale.baseline_ratio", "is another rig's")
        if not np.linalg.eigvalsh(covariance)[0] >= -1e-9 * np.abs(covariance).max():
            raise self._bad("scale.covariance", "is no covariance")
        bias = self._number("scale.bias_sigma_px", 0.0) if "bias_sigma_px" in self._get("scale") else None
        return ratio, covariance, int(self._number("scale.drives_with_gnss", 0.0)), bias

    def _receivers(self) -> tuple[ReceiverEvidence, ...]:
        tables = self.content.get("receiver", [])
        if not isinstance(tables, list):
            raise self._bad("receiver", "must be tables, [[receiver]]")
        return tuple(_Reader(self.file, table).receiver() for table in tables)

    def receiver(self) -> ReceiverEvidence:
        """What one drive tells of the receiver, of its table."""
        name, t_ns = self._get("drive"), self._get("t_ns")
        if not isinstance(name, str) or not isinstance(t_ns, int) or isinstance(t_ns, bool):
            raise self._bad("receiver", "needs drive, a text, and t_ns, a whole number")
        information = self._matrix("information", STATES)
        if not np.linalg.eigvalsh(information)[0] >= -1e-6 * np.abs(information).max():
            raise self._bad("receiver.information", "has a negative eigenvalue")
        return ReceiverEvidence(name, t_ns, information, self._floats("pull", STATES))

    def _determined(self) -> NDArray[np.bool_]:
        known = [self._get(f"right_lens.determined.{name}") for name in PARAMETERS]
        for name, value in zip(PARAMETERS, known, strict=True):
            if not isinstance(value, bool):
                raise self._bad(f"right_lens.determined.{name}", f"{value!r} is neither true nor false")
        return np.array(known, bool)

    def _rig_id(self) -> str | None:
        value = self.content.get("rig_id")
        if value is not None and not isinstance(value, str):
            raise self._bad("rig_id", f"{value!r} is no text")
        return value

    def _drives(self) -> tuple[str, ...]:
        value = self._get("drives")
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise self._bad("drives", "must be a list of names")
        return tuple(value)

    def _rig(self) -> StereoRig:
        fx, fy = (self._number(f"camera.{name}", 1.0) for name in ("fx", "fy"))
        cx, cy = (self._number(f"camera.{name}") for name in ("cx", "cy"))
        width, height = (int(self._number(f"camera.{name}", 1.0)) for name in ("width", "height"))
        tx, ty, tz = self._floats("camera.t_right_left_m", 3)
        if not tx < 0:
            raise self._bad("camera.t_right_left_m", "the baseline is not positive")
        return StereoRig(PinholeCamera(fx, fy, cx, cy, width, height), (float(tx), float(ty), float(tz)))

    def _bad(self, key: str, what: str) -> CalibrationError:
        return CalibrationError(what, file=self.file, record=key, remedy=REMEDY)
