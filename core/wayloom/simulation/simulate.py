"""Drives of the simulated city, written as logs."""

from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from wayloom.config.progress import Progress, silent
from wayloom.errors import ConfigError
from wayloom.geometry.camera import StereoRig
from wayloom.logs.drive_writer import DriveWriter
from wayloom.logs.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.kitti_raw_writer import KittiRawWriter
from wayloom.logs.sidecar import SIMULATED_RIG
from wayloom.logs.types import Image, StereoFrame
from wayloom.simulation import gnss
from wayloom.simulation.camera import Radiance, Sensor, adapted, exposed, wanted_gain
from wayloom.simulation.paths import AVENUE_LANE_M, LANE_M, lane_path
from wayloom.simulation.presets import CITY_ORIGIN, START_NS, DrivePlan, Preset, find_preset
from wayloom.simulation.renderer import Truth, World
from wayloom.simulation.rigs import right_camera, sized_rig
from wayloom.simulation.routes import Route, drive, nearest_s
from wayloom.simulation.truth_files import write_poses_enu, write_truth
from wayloom.simulation.worlds import build_world

WRITERS: Final[dict[str, type[DriveWriter]]] = {"kitti": KittiOdometryWriter, "kitti-raw": KittiRawWriter}
SET_UP_SHARE = 0.1
EGO_CLEARANCE_M = 4.5
NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Drawn:
    """One stereo pair before exposure, and its truth where asked for."""

    radiance: tuple[Radiance, Radiance]
    truth: tuple[Truth, Truth] | None


def simulate(
    preset: str | Preset,
    out_dir: Path,
    size: str = "half",
    seed: int | None = None,
    format: str = "kitti",
    truth: bool = False,
    threads: int = 1,
    progress: Progress = silent,
) -> list[Path]:
    """Write every drive of a preset to out_dir/<vehicle>; returns their folders. The bytes do not depend on `threads`.

    size    "full", "half" or "quarter" of KITTI-360's images
    seed    another city than the preset's
    format  "kitti" (odometry layout) or "kitti-raw"
    truth   also write depth, class, instance of both cameras, and poses_enu.txt, to <vehicle>/truth
    Raises ConfigError for an unknown preset, size or format; LogError where a drive's folder is not empty.
    """
    chosen = find_preset(preset) if isinstance(preset, str) else preset
    if format not in WRITERS:
        raise ConfigError(f"unknown format {format!r}", remedy=f"use one of {', '.join(WRITERS)}")
    rig = sized_rig(size)
    chosen = chosen if seed is None else chosen.model_copy(update={"seed": seed})
    progress(0.0, "building the city")
    world = build_world(chosen.seed, chosen.columns, chosen.rows, chosen.light, size, chosen.traffic)
    frames = sum(plan.frames for plan in chosen.drives)
    done, paths = 0, []
    for number, plan in enumerate(chosen.drives):
        writer = WRITERS[format](
            out_dir / plan.vehicle_id, rig, rig_id=f"{SIMULATED_RIG}{chosen.name}-{plan.vehicle_id}", vehicle_id=plan.vehicle_id,
            p_cam_gnss=np.array(plan.p_cam_gnss_m),
        )  # fmt: skip
        with writer:
            for _ in write_drive(writer, world, rig, chosen, number, truth, threads):
                done += 1
                progress(SET_UP_SHARE + (1 - SET_UP_SHARE) * done / frames, f"{plan.vehicle_id}: frame {done} of {frames}")
        paths.append(writer.path)
    return paths


def plan_route(world: World, plan: DrivePlan, rate_hz: float) -> Route:
    """The poses of a drive. Raises ConfigError where the path ends before the drive does."""
    graph = world.city.graph
    avenue = all(graph.street(a, b).is_avenue for a, b in zip(plan.nodes, plan.nodes[1:], strict=False))
    path = lane_path(graph.nodes[list(plan.nodes)], AVENUE_LANE_M if avenue else LANE_M)
    start = nearest_s(path, graph.nodes[plan.nodes[plan.reference]]) - plan.before_m
    route = drive(path, start, plan.start_s, plan.frames, rate_hz, plan.fastest_m_s)
    last = np.array([route.x[-1], route.y[-1]])
    if start < 0 or np.hypot(*(last - path.xy[-1])) < 1.0:
        what = f"{plan.vehicle_id} starts {start:.0f} m into a way of {path.length_m:.0f} m and drives off its end"
        raise ConfigError(what, remedy="pass more crossings, or drive fewer frames")
    return route


def write_drive(
    writer: DriveWriter, world: World, rig: StereoRig, preset: Preset, number: int, truth: bool, threads: int
) -> Iterator[int]:
    """Write drive `number` of a preset, frame by frame; yields each frame's index when it is written."""
    plan = preset.drives[number]
    route = plan_route(world, plan, preset.rate_hz)
    t_ns = START_NS + np.rint(route.t_s * NS).astype(np.int64)
    rng = np.random.default_rng([preset.seed, number, 1])
    for packet in gnss.receive(t_ns, route.T_enu_cam, CITY_ORIGIN, np.array(plan.p_cam_gnss_m), plan.fix_plan, rng):
        writer.add_gnss(packet)
    for index, (left, right, truths) in enumerate(_frames(world, rig, route, preset, number, truth, threads)):
        writer.add(StereoFrame(index, int(t_ns[index]), left, right), route.T_enu_cam[index])
        if truths is not None:
            write_truth(writer.folder / "truth", index, truths)
        yield index
    if truth:
        write_poses_enu(writer.folder / "truth" / "poses_enu.txt", route.T_enu_cam)


def _frames(
    world: World, rig: StereoRig, route: Route, preset: Preset, number: int, truth: bool, threads: int
) -> Iterator[tuple[Image, Image, tuple[Truth, Truth] | None]]:
    """The exposed pairs in order. Drawing runs ahead in `threads` threads; exposure control goes from frame to frame."""
    plan = preset.drives[number]
    left_out = world.traffic.meeting(route.x, route.y, route.t_s, EGO_CLEARANCE_M)
    gain: float | None = None
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[Future[Drawn]] = deque()
        for index in range(len(route.t_s) + threads):
            if index < len(route.t_s):
                ahead.append(pool.submit(draw_pair, world, rig, route.T_enu_cam[index], float(route.t_s[index]), left_out, truth))
            if index < threads:
                continue
            drawn, frame = ahead.popleft().result(), index - threads
            gain = adapted(gain, wanted_gain(drawn.radiance[0]))
            left, right = (
                exposed(radiance, gain, rig.camera, Sensor(factor), np.random.default_rng([preset.seed, number, 2, frame, side]))
                for side, (radiance, factor) in enumerate(zip(drawn.radiance, (1.0, plan.right_gain), strict=True))
            )
            yield left, right, drawn.truth


def draw_pair(world: World, rig: StereoRig, T_world_left: np.ndarray, t_s: float, left_out: frozenset[int], truth: bool) -> Drawn:
    """Both images of a pair at one moment, and their truth where asked for."""
    scene = world.scene(rig.camera, T_world_left, t_s, left_out)
    poses = (T_world_left, right_camera(T_world_left, rig))
    left, right = (scene.image(rig.camera, T) for T in poses)
    truths = (scene.truth(rig.camera, poses[0]), scene.truth(rig.camera, poses[1])) if truth else None
    return Drawn((left, right), truths)
