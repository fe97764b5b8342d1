"""Recording of one drive: planning, threaded rendering, frame-by-frame writing, resumption after an interruption."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from wayloom.logs.drive_writer import DriveWriter
from wayloom.logs.types import ImuTrack
from wayloom.simulation.recording.journal import Journal
from wayloom.simulation.recording.presets import CITY_ORIGIN, START_NS, DrivePlan, Preset
from wayloom.simulation.recording.truth_files import TruthFolder
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.sensors import gnss, imu, lidar
from wayloom.simulation.sensors.capture import Captured, CaptureSettings, ResumePoint, StereoCamera, capture
from wayloom.simulation.sensors.clock import stamps_ns
from wayloom.simulation.sensors.exposure import exposure_of
from wayloom.simulation.sensors.gnss import GnssRecord
from wayloom.simulation.sensors.imu import ImuRecord
from wayloom.simulation.traffic.drives import Drive, RoutePlan
from wayloom.simulation.traffic.routes import Route
from wayloom.simulation.traffic.traffic import FIRST_MOVER
from wayloom.simulation.vehicle.motion import camera_poses

F64 = NDArray[np.float64]
NS: Final = 1_000_000_000
GNSS_STREAM, SENSOR_STREAM, IMU_STREAM, LIDAR_STREAM, PACKET_STREAM = 1, 2, 3, 4, 5


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of a route's time, or several laps of it, as a `Motion`."""

    route: Route
    start_s: float
    end_s: float

    def pose(self, t_s: F64) -> F64:
        """T_enu_body (M, 4, 4) at t_s (M,)."""
        return self.route.pose(t_s)


@dataclass(frozen=True, slots=True)
class Recording:
    """Plan of a drive's recording.

    motion     of the vehicle from the first frame to the last
    t_s        (N,) s since the city's time zero
    rendered   number of first frames that are rendered; the others repeat them
    T_enu_cam  (N, 4, 4) of the left camera
    """

    number: int
    plan: DrivePlan
    drive: Drive
    motion: Stretch
    t_s: F64
    rendered: int
    T_enu_cam: F64

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def t_ns(self) -> NDArray[np.int64]:
        """(N,) time stamps of the frames."""
        return START_NS + np.rint(self.t_s * NS).astype(np.int64)

    @property
    def start_ns(self) -> int:
        """The cameras' time stamp of the drive's start."""
        return START_NS + round(self.motion.start_s * NS)


def route_plan(plan: DrivePlan, preset: Preset) -> RoutePlan:
    """The drive's route and schedule for the traffic simulation."""
    return RoutePlan(
        nodes=plan.nodes,
        start_s=plan.start_s,
        closed=plan.closed,
        reference=plan.reference,
        before_m=plan.before_m,
        duration_s=None if plan.frames is None else (plan.frames - 1) / preset.rate_hz,
        fastest_m_s=plan.fastest_m_s,
        laps=preset.laps is not None,
    )


def plan_recording(preset: Preset, number: int, drive: Drive, frames: int | None = None) -> Recording:
    """Frame times and poses of a drive; `frames` limits their number."""
    plan, route = preset.drives[number], drive.route
    if preset.laps is not None and route.lap_s is not None:
        a_lap = round(route.lap_s * preset.rate_hz)
        count, step_s = preset.laps * a_lap, route.lap_s / a_lap
    else:
        step_s = 1 / preset.rate_hz
        a_lap = count = int(np.floor((route.end_s - route.start_s) / step_s + 1e-6)) + 1
    count = count if frames is None else min(count, frames)
    t_s = np.asarray(route.start_s + step_s * np.arange(count), np.float64)
    motion = Stretch(route, route.start_s, float(t_s[-1]))
    T = camera_poses(route, plan.vehicle.T_body_cam, t_s)
    return Recording(number, plan, drive, motion, t_s, min(count, a_lap), T)


def record(
    writer: DriveWriter,
    journal: Journal,
    world: World,
    preset: Preset,
    recording: Recording,
    size: str,
    truth: TruthFolder | None,
    threads: int,
) -> Iterator[int]:
    """Write a drive, from where the journal ends; yields the number of frames that are whole after each.

    size   "full", "half" or "quarter" of the rig's images
    truth  where ground truth is written; None for none
    """
    labels = writer.has_labels
    vehicle, world = recording.plan.vehicle, replace(world, traffic=recording.drive.traffic)
    camera = StereoCamera(vehicle, size, recording.motion)
    left_out = recording.drive.left_out

    def keep(index: int, captured: Captured) -> None:
        writer.write_images(index, captured.left, captured.right)
        if captured.truth is not None:
            if truth is not None:
                truth.write_images(index, captured.truth)
            for side, seen in enumerate(captured.truth if labels else ()):
                writer.write_labels(index, side, seen.class_id, seen.instance)
        if vehicle.lidar is not None and index % vehicle.lidar.every == 0:
            rng = np.random.default_rng([preset.city.seed, recording.number, LIDAR_STREAM, index])
            T = recording.T_enu_cam[index] @ vehicle.T_cam_lidar
            scan = lidar.scan(world, T, float(recording.t_s[index]), vehicle.lidar, rng, left_out)
            points = np.column_stack([scan.points, scan.reflectance])
            writer.write_lidar(index, points, scan.class_id, scan.instance, scan.instance >= FIRST_MOVER)
            if truth is not None:
                truth.write_scan_labels(index, scan.class_id, scan.instance)

    settings = CaptureSettings(left_out, labels or truth is not None, (preset.city.seed, recording.number, SENSOR_STREAM))
    resume = ResumePoint(len(journal), journal.factors[-1] if len(journal) else None)
    pairs = capture(camera, world, recording.t_s[: recording.rendered], settings, threads, resume, keep)
    for captured in pairs:
        journal.add(captured.factors)
        yield len(journal)
    for index in range(recording.rendered, len(recording)):
        writer.repeat(index, index % recording.rendered)
        if truth is not None:
            truth.repeat(index, index % recording.rendered)
        yield index + 1
    for t_ns, T in zip(recording.t_ns.tolist(), recording.T_enu_cam, strict=True):
        writer.count(t_ns, T)
    inertia = inertial(preset, recording)
    fixes = position(writer, preset, recording, inertia)
    exposures = [tuple(exposure_of(f, vehicle.exposure) for f in factors) for factors in journal.factors]
    shown = [exposures[index % recording.rendered] for index in range(len(recording))]
    if vehicle.exposure.logged:
        writer.set_exposures(np.array([[e.exposure_s * e.gain for e in pair] for pair in shown]))
    if truth is not None:
        truth.write_poses(recording.T_enu_cam)
        truth.write_frames(recording.t_ns, shown, recording.t_s, inertia)
        if fixes is not None:
            truth.write_fixes(fixes, START_NS)
        truth.write_vehicle(vehicle, size, camera.cameras)
        truth.write_surface(camera.cameras[0], recording.T_enu_cam[: recording.rendered])
        truth.write_city(world.city, recording.T_enu_cam)


def inertial(preset: Preset, recording: Recording) -> ImuRecord | None:
    """IMU measurements of a recording with their errors; None without an IMU."""
    vehicle = recording.plan.vehicle
    if vehicle.imu is None:
        return None
    rng = np.random.default_rng([preset.city.seed, recording.number, IMU_STREAM])
    return imu.simulated_samples(recording.motion, vehicle.T_body_cam @ vehicle.T_cam_imu, vehicle.imu, rng)


def position(writer: DriveWriter, preset: Preset, recording: Recording, inertia: ImuRecord | None) -> GnssRecord | None:
    """Pass fixes and IMU samples to the writer, in the form of its layout; returns the fixes with their true errors."""
    vehicle, motion, start_ns = recording.plan.vehicle, recording.motion, recording.start_ns
    stream = [preset.city.seed, recording.number]
    fixes = gnss.simulated_fixes(motion, vehicle, np.random.default_rng([*stream, GNSS_STREAM]))
    if fixes is not None and writer.wants_packets:
        rng = np.random.default_rng([*stream, PACKET_STREAM])
        for packet in gnss.packets(fixes, motion, vehicle, CITY_ORIGIN, start_ns, rng):
            writer.add_gnss(packet)
    elif fixes is not None:
        writer.set_gnss(gnss.track(fixes, motion, vehicle, CITY_ORIGIN, start_ns))
    if inertia is not None:
        t_ns = stamps_ns(inertia.t_s, motion.start_s, start_ns, vehicle.clock)
        writer.set_imu(ImuTrack(t_ns, inertia.force, inertia.rate))
    return fixes
