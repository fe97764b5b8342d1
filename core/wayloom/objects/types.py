"""Objects: what one drive saw along one submap, immutable and addressed by its content, and the objects of the map.

Sightings are kept in their submap's frame, so nothing in them changes when the map is optimised: T_enu_submap places them.
Their bytes are a `wayloom.files.blob` (`docs/formats.md`, "Object sightings").
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.errors import InputError
from wayloom.files.blob import decode_blob, encode_blob
from wayloom.geometry import se3

FloatArray = NDArray[np.float64]
KINDS: Final = ("pole", "traffic_sign", "traffic_light", "trunk")
POLE, SIGN, LIGHT, TRUNK = range(len(KINDS))
STANDING: Final = (POLE, TRUNK)
"""Kinds whose position is their foot on the ground; that of the others is the middle of their face."""
CELL_M: Final = 0.5
"""Of the raster of looks."""
MAGIC: Final = b"WLOBJECT"
VERSION: Final = 1
DTYPES: Final = {
    "T_submap_level": "<f8", "corner": "<i4", "looked": "|u1",
    "kind": "|u1", "position": "<f4", "covariance": "<f4", "bottom_m": "<f4", "top_m": "<f4", "width_m": "<f4",
    "facing": "<f4", "facing_sigma": "<f4", "looks": "<u2", "evidence_for": "<f4", "evidence_against": "<f4",
    "first_ns": "<i8", "last_ns": "<i8",
}  # fmt: skip
SHAPES: Final[dict[str, tuple[int, ...]]] = {"position": (3,), "covariance": (3, 3), "facing": (3,)}
"""Of one object, of the columns that are not plain numbers."""
RASTER: Final = ("T_submap_level", "corner", "looked")
COLUMNS: Final = tuple(name for name in DTYPES if name not in RASTER)


@dataclass(frozen=True)
class ObjectSightings:
    """N things that one drive saw along one submap, and where it looked.

    submap            digest of the submap that they belong to
    T_submap_level    (4, 4) float64: a frame at the submap's origin whose z axis was up when they were made
    corner            (2,) int32 column and row of cell [0, 0] of `looked`: its low corner is at corner * CELL_M in the level frame
    looked            (H, W) uint8: of how many keyframes the view went through the cell, 0.5 to 3 m over the ground
    kind              (N,) uint8 row of KINDS
    position          (N, 3) float32 m, submap frame: of a pole or trunk the foot of its axis, else the middle of the face
    covariance        (N, 3, 3) float32 m^2, submap frame, relative to the submap
    bottom_m, top_m   (N,) float32 its ends over the ground
    width_m           (N,) float32
    facing            (N, 3) float32 unit vector, submap frame, out of the face of a sign; NaN where it is not known
    facing_sigma      (N,) float32 rad; NaN likewise
    looks             (N,) uint16 keyframes that saw it
    evidence_for      (N,) float32 log-odds that it is there, by what was seen of it; not negative
    evidence_against  (N,) float32 log-odds that it is not, by views that stand against it; not negative
    first_ns, last_ns (N,) int64 times of the first and last image that showed it
    """

    submap: str
    T_submap_level: FloatArray
    corner: NDArray[np.int32]
    looked: NDArray[np.uint8]
    kind: NDArray[np.uint8]
    position: NDArray[np.float32]
    covariance: NDArray[np.float32]
    bottom_m: NDArray[np.float32]
    top_m: NDArray[np.float32]
    width_m: NDArray[np.float32]
    facing: NDArray[np.float32]
    facing_sigma: NDArray[np.float32]
    looks: NDArray[np.uint16]
    evidence_for: NDArray[np.float32]
    evidence_against: NDArray[np.float32]
    first_ns: NDArray[np.int64]
    last_ns: NDArray[np.int64]

    def __post_init__(self) -> None:
        wanted = {name: (len(self.kind), *SHAPES.get(name, ())) for name in COLUMNS}
        for name, shape in {**wanted, "T_submap_level": (4, 4), "corner": (2,)}.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} is {getattr(self, name).shape}, not {shape}")
        if self.looked.ndim != 2:
            raise ValueError(f"looked is {self.looked.shape}, no raster")
        if (self.kind >= len(KINDS)).any():
            raise ValueError(f"there is a kind {self.kind.max()}; the last one is {len(KINDS) - 1}")

    def __len__(self) -> int:
        return len(self.kind)

    def looked_at(self, points_submap: FloatArray) -> NDArray[np.int64]:
        """(M,) of how many keyframes the view went through the cell of each of points (M, 3) m; 0 outside of the raster."""
        at = se3.transform(se3.inverse(self.T_submap_level), points_submap)[:, :2] / CELL_M
        column, row = (np.floor(at) - self.corner).astype(np.int64).T
        rows, columns = self.looked.shape
        inside = (column >= 0) & (row >= 0) & (column < columns) & (row < rows)
        out = np.zeros(len(points_submap), np.int64)
        out[inside] = self.looked[row[inside], column[inside]]
        return out

    @cached_property
    def encoded(self) -> bytes:
        """The sightings' bytes."""
        arrays = {name: np.asarray(getattr(self, name), dtype) for name, dtype in DTYPES.items()}
        return encode_blob(MAGIC, VERSION, {"submap": self.submap}, arrays)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the bytes, hexadecimal: the sightings' name."""
        return hashlib.sha256(self.encoded).hexdigest()


def decode_sightings(data: bytes, name: str = "object sightings") -> ObjectSightings:
    """The sightings of these bytes. Raises InputError when they are none, cut off or of another version."""
    try:
        header, arrays = decode_blob(data, MAGIC, VERSION, DTYPES)
        return ObjectSightings(submap=str(header["submap"]), **arrays)
    except (ValueError, KeyError, TypeError) as error:
        problem = f"holds no sightings of objects or is damaged ({error})"
        raise InputError(problem, file=name, remedy="run the stage objects again") from error


@dataclass(frozen=True, slots=True)
class PlacedSightings:
    """Sightings with the place of their submap.

    T_enu_submap  (4, 4) in the map's frame
    covariance    (6, 6) of its left perturbation (v, omega), m^2 and rad^2; NaN where it is not known: taken for exact
    """

    sightings: ObjectSightings
    T_enu_submap: FloatArray
    covariance: FloatArray
    drive_id: str


@dataclass(frozen=True, slots=True)
class MapObject:
    """An object of the map.

    id                  of its kind and place, the same for every order of arrival
    kind                one of KINDS
    position            (3,) m, enu: of a pole or trunk the foot of its axis, else the middle of its face
    covariance          (3, 3) m^2, enu
    bottom_m, height_m  its lower and upper end over the ground
    width_m             across; of a pole or trunk its thickness
    facing_rad          clockwise from north, where a sign's face looks; None where it is not known, and of other kinds
    facing_sigma_rad    None likewise
    confidence          probability that it stands there, 0 to 1
    drives              that saw it, sorted
    looks               keyframes that saw it, of all drives
    first_ns, last_ns   times of the first and last image that showed it
    """

    id: str
    kind: str
    position: FloatArray
    covariance: FloatArray
    bottom_m: float
    height_m: float
    width_m: float
    facing_rad: float | None
    facing_sigma_rad: float | None
    confidence: float
    drives: tuple[str, ...]
    looks: int
    first_ns: int
    last_ns: int
