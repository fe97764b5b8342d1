"""Traffic of a city as a function of time: vehicles, pedestrians and lit signal lamps."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from wayloom.config.classes import CLASS_ID
from wayloom.simulation.city.city import City
from wayloom.simulation.city.furniture import LAMP_TINTS, LENS_UV, lens
from wayloom.simulation.city.instance_ids import FIRST_MOVER as FIRST_MOVER
from wayloom.simulation.city.instance_ids import vehicle_number
from wayloom.simulation.city.streets import F64
from wayloom.simulation.models.mesh import Mesh, MeshBuilder, posed
from wayloom.simulation.textures.materials import Material
from wayloom.simulation.traffic import signals
from wayloom.simulation.traffic.pedestrians import People

SEEN_FROM_M, PERSON_SEEN_FROM_M, SIGNALS_SEEN_FROM_M = 220.0, 100.0, 130.0
TALLEST_M = 3.8
BRAKE_LAMP_M_S2, STANDING_M_S = 0.6, 0.3
AXLES = 0.3
"""A vehicle's axles are this share of its length before and behind its middle."""


@dataclass(frozen=True, slots=True)
class PlacedModel:
    """A moving object at one moment, with its bounding sphere: centre (3,) m and radius_m.

    model          around its own origin, to be put at T_world_model (4, 4) as thing `number`; without one, already in its place
    """

    model: Mesh
    centre: F64
    radius_m: float
    T_world_model: F64 | None = None
    number: int = 0

    @property
    def mesh(self) -> Mesh:
        """Its transformed mesh; made when asked for, since most moving objects are out of view."""
        return self.model if self.T_world_model is None else posed(self.model, self.T_world_model, self.number)


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Trajectory of one vehicle: s (N,) m and xy (N, 2) m of its path, front_m (K,) of its front at even steps from born_s on.

    mesh, braking  its mesh without and with lit brake lamps
    """

    order: int
    mesh: Mesh
    braking: Mesh
    length_m: float
    s: F64
    xy: F64
    born_s: float
    step_s: float
    front_m: F64

    @property
    def gone_s(self) -> float:
        """Time at which it is removed, s."""
        return self.born_s + (len(self.front_m) - 1) * self.step_s

    def middle_m(self, t_s: float) -> float:
        """Arc length of its middle along its path, m: between two steps a cubic with the mean speeds around each."""
        k, u = self._step(t_s)
        (v0, v1), w = self._speeds(k), self.front_m
        rising = u * u * (3 - 2 * u)
        return float(w[k] + rising * (w[k + 1] - w[k]) + u * (1 - u) * ((1 - u) * v0 - u * v1)) - 0.5 * self.length_m

    def brakes(self, t_s: float) -> bool:
        """Whether its brake lamps are on."""
        v0, v1 = self._speeds(self._step(t_s)[0])
        return bool(v1 - v0 < -BRAKE_LAMP_M_S2 * self.step_s**2 or v1 < STANDING_M_S * self.step_s)

    def _step(self, t_s: float) -> tuple[int, float]:
        """The step before a time, and the share of the next one that has passed."""
        steps = (t_s - self.born_s) / self.step_s
        k = int(np.clip(np.floor(steps), 0, len(self.front_m) - 2))
        return k, steps - k

    def _speeds(self, k: int) -> tuple[float, float]:
        """Speed at step k and at the next one, m a step."""
        w, last = self.front_m, len(self.front_m) - 1
        return float(w[k + 1] - w[max(k - 1, 0)]) / (2 if k else 1), float(w[min(k + 2, last)] - w[k]) / (2 if k + 2 <= last else 1)

    def at(self, t_s: float) -> tuple[float, float, float]:
        """x, y m and yaw rad: between the axles, as they run along the line."""
        s = self.middle_m(t_s) + np.array([-AXLES, AXLES]) * self.length_m
        x, y = (np.interp(s, self.s, self.xy[:, k]) for k in (0, 1))
        return float(x.mean()), float(y.mean()), float(np.arctan2(y[1] - y[0], x[1] - x[0]))


class TrafficSource(Protocol):
    """Source of the vehicles present at a time."""

    def vehicles(self, t_s: float) -> Sequence[Vehicle]:
        """The vehicles that are there at a time."""
        ...


class RecordedTraffic:
    """Vehicles with trajectories known from start to end."""

    def __init__(self, vehicles: Sequence[Vehicle]) -> None:
        self._all = list(vehicles)
        self._born = np.array([v.born_s for v in vehicles])
        self._gone = np.array([v.gone_s for v in vehicles])

    def vehicles(self, t_s: float) -> list[Vehicle]:
        """The vehicles that are there at a time."""
        return [self._all[k] for k in np.nonzero((self._born <= t_s) & (t_s < self._gone))[0]]


class Traffic:
    """Vehicles, pedestrians and lit signals of a city."""

    def __init__(self, city: City, source: TrafficSource) -> None:
        self._city, self._source, self._people = city, source, People(city)

    def vehicles(self, t_s: float) -> Sequence[Vehicle]:
        """All vehicles of a time."""
        return self._source.vehicles(t_s)

    def meeting(self, x: F64, y: F64, t_s: F64, clearance_m: float) -> frozenset[int]:
        """The numbers of vehicles that come within clearance_m (and half their length) of a place x, y (N,) m at times t_s (N,)."""
        found = set()
        for px, py, t in zip(x, y, t_s, strict=True):
            for vehicle in self._source.vehicles(float(t)):
                if np.hypot(*(np.array(vehicle.at(float(t))[:2]) - (px, py))) < clearance_m + 0.5 * vehicle.length_m:
                    found.add(vehicle_number(vehicle.order))
        return frozenset(found)

    def around(self, x: float, y: float, t_s: float, left_out: frozenset[int] = frozenset()) -> list[PlacedModel]:
        """Moving objects near x, y (m) at a time, without the instance numbers left out; and the lit signal lamps."""
        found: list[tuple[Mesh, int, tuple[float, float, float], float, float]] = []
        for vehicle in self._source.vehicles(t_s):
            number, place = vehicle_number(vehicle.order), vehicle.at(t_s)
            if number not in left_out and np.hypot(place[0] - x, place[1] - y) < SEEN_FROM_M:
                mesh = vehicle.braking if vehicle.brakes(t_s) else vehicle.mesh
                found.append((mesh, number, place, 0.0, 0.5 * vehicle.length_m + TALLEST_M))
        for walker in self._people.around(x, y, PERSON_SEEN_FROM_M):
            if walker.number not in left_out:
                found.append((walker.mesh(t_s), walker.number, walker.at(t_s), walker.lift_m, TALLEST_M))
        return self._standing(found) + self._signals(x, y, t_s)

    def _standing(self, found: list[tuple[Mesh, int, tuple[float, float, float], float, float]]) -> list[PlacedModel]:
        """Meshes with their numbers, places (x, y m, yaw rad), heights above the ground and radii (m), placed on the ground."""
        if not found:
            return []
        meshes, numbers, places, lifts_m, radii_m = zip(*found, strict=True)
        poses = self._city.ground.poses_on_ground(*np.array(places).T)
        poses[:, 2, 3] += lifts_m
        return [
            PlacedModel(mesh, T[:3, 3], radius, T, number)
            for mesh, number, T, radius in zip(meshes, numbers, poses, radii_m, strict=True)
        ]

    def _signals(self, x: float, y: float, t_s: float) -> list[PlacedModel]:
        """The lamps that are lit, as one mesh."""
        m = MeshBuilder()
        for face in self._city.faces(x, y, SIGNALS_SEEN_FROM_M):
            for lamp in signals.lit(self._city.graph, face.node, face.origin, t_s):
                quads = lens(face.at, face.facing, lamp, 0.012)
                m.quads(quads, [LENS_UV] * len(quads), Material.LIT, CLASS_ID["traffic light"], face.number, LAMP_TINTS[lamp])
        mesh = m.build()
        here = np.array([x, y, float(self._city.ground.height(np.array(x), np.array(y)))])
        return [PlacedModel(mesh, here, SIGNALS_SEEN_FROM_M)] if len(mesh) else []
