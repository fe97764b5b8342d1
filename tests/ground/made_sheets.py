"""Ground sheets cut out of a made street: asphalt with lane dashes between kerbs, its exact height, colour and classes known."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wayloom.geometry import se3
from wayloom.ground.placed_sheet import PlacedSheet
from wayloom.ground.sheet import CELL_M, NO_HEIGHT, PIXEL_M, GroundSheet

FloatArray = NDArray[np.float64]
HALF_ROAD_M, HALF_STREET_M, KERB_M = 4.0, 9.0, 0.12
DASH_M, DASH_EVERY_M, DASH_WIDE_M = 3.0, 6.0, 0.12
SURE = np.diag([0.02**2, 0.02**2, 0.02**2, 1e-8, 1e-8, 1e-8])


@dataclass(frozen=True)
class Street:
    """Along x of the map, its middle at y of `middle_m`. patch: x from, to, y from, to of asphalt that was laid anew, darker and
    with a grain of its own; step_m how much lower it lies."""

    middle_m: float = 30.0
    patch: tuple[float, float, float, float] | None = None
    darker: float = 60.0
    step_m: float = 0.0

    def _in_patch(self, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        if self.patch is None:
            return np.zeros(x.shape, np.bool_)
        west, east, south, north = self.patch
        return (x >= west) & (x < east) & (y >= south) & (y < north)

    def height(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """m: 2 % along, 1 % across, kerbs."""
        off = np.abs(y - self.middle_m)
        base = 0.02 * x + 0.01 * (y - self.middle_m)
        return base + KERB_M * (off > HALF_ROAD_M) - self.step_m * self._in_patch(x, y)

    def grey(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Grey levels in good light."""
        u, v = np.where(self._in_patch(x, y), (y, -x), (x, y))
        waves = sum(np.sin(fx * u + fy * v + phase) for fx, fy, phase in WAVES)
        off = np.abs(y - self.middle_m)
        grey = np.where(off > HALF_ROAD_M, 150.0, 95.0) + 4.0 * waves - self.darker * self._in_patch(x, y)
        dash = (np.mod(x, DASH_EVERY_M) < DASH_M) & (off < DASH_WIDE_M / 2.0) & ~self._in_patch(x, y)
        return np.where(dash, 220.0, grey)


WAVES = tuple((*pair, 0.7 * k) for k, pair in enumerate([(1.1, 0.7), (-2.3, 1.9), (4.1, -3.3), (0.5, 5.7), (7.9, 2.2)]))


def cut(
    street: Street,
    start_m: float,
    end_m: float,
    drive_id: str = "a" * 64,
    seed: int = 0,
    believed: tuple[float, float, float] = (0.0, 0.0, 0.0),
    gain: float = 1.0,
    sharpness: int = 60,
    t_s: int = 100,
    channels: int = 3,
    yaw: float = 0.2,
    shade: tuple[float, float] | None = None,
    covariance: FloatArray = SURE,
    wide_m: float = HALF_STREET_M,
    noise: float = 2.0,
) -> PlacedSheet:
    """The sheet of a drive that passed from start to end (m along the street).

    believed : by how much its place in the map is wrong, m; gain: its exposure; shade: x from, to that lay in shadow when it came
    """
    rng = np.random.default_rng([seed, 5])
    T_map_sheet = se3.exp(np.array([0.0, 0.0, 0.0, 0.004, -0.006, yaw]))
    middle = (start_m + end_m) / 2.0
    T_map_sheet[:3, 3] = middle, street.middle_m, float(street.height(np.array(middle), np.array(street.middle_m)))
    half = np.hypot(end_m - start_m, 2.0 * wide_m) / 2.0 + 0.2
    count = int(np.ceil(half / CELL_M))
    corner = np.array([-count, -count], np.int32)

    def on_ground(step_m: float, per_side: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """x, y of the map and the height in the sheet's frame of each middle."""
        place = (np.arange(per_side) + 0.5) * step_m - count * CELL_M
        u, v = np.meshgrid(place, place)
        h = np.zeros_like(u)
        for _ in range(4):
            x, y, z = (T_map_sheet[k, 0] * u + T_map_sheet[k, 1] * v + T_map_sheet[k, 2] * h + T_map_sheet[k, 3] for k in range(3))
            h = h + (street.height(x, y) - z)
        return x, y, h

    def inside(x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
        return (x >= start_m) & (x < end_m) & (np.abs(y - street.middle_m) < wide_m)

    x, y, h = on_ground(CELL_M, 2 * count)
    there = inside(x, y)
    height = np.where(there, np.rint(1000.0 * h + rng.normal(0.0, noise, h.shape)), NO_HEIGHT).astype(np.int16)
    votes = np.zeros((*there.shape, 3), np.uint16)
    votes[..., 0] = 100 * (there & (np.abs(y - street.middle_m) <= HALF_ROAD_M))
    votes[..., 1] = 100 * (there & (np.abs(y - street.middle_m) > HALF_ROAD_M))
    fine_x, fine_y, _ = on_ground(PIXEL_M, 4 * count)
    seen = inside(fine_x, fine_y)
    light = gain * (1.0 if shade is None else np.where((fine_x >= shade[0]) & (fine_x < shade[1]), 0.55, 1.0))
    grey = np.clip(np.rint(light * street.grey(fine_x, fine_y) + rng.normal(0.0, noise, seen.shape)), 0, 255)
    colour = np.repeat(np.where(seen, grey, 0).astype(np.uint8)[..., None], channels, axis=2)
    T_submap_sheet = np.eye(4)
    T_submap_sheet[:3, :3] = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]
    sheet = GroundSheet(
        submap=f"{seed:064x}",
        T_submap_sheet=T_submap_sheet,
        corner=corner,
        t_ns=np.array([t_s, t_s + 10], np.int64) * 1_000_000_000,
        height_mm=height,
        sigma_mm=np.where(there, 6, 255).astype(np.uint8),
        votes=votes,
        colour=colour,
        sharpness=(sharpness * seen).astype(np.uint8),
    )
    T_map_believed = T_map_sheet.copy()
    T_map_believed[:3, 3] += believed
    return PlacedSheet(drive_id, sheet.digest, lambda: sheet, T_map_believed @ np.linalg.inv(T_submap_sheet), covariance)
