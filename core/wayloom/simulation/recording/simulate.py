"""Simulation runs: the drives of a preset written as logs."""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from wayloom import __version__
from wayloom.config.progress import Progress, silent
from wayloom.errors import ConfigError, LogError
from wayloom.logs.drive_writer import DriveWriter, ImageEncoding, SensorExtrinsics, unfinished_folder
from wayloom.logs.euroc.euroc_writer import EurocWriter
from wayloom.logs.kitti.kitti_360_writer import Kitti360Writer
from wayloom.logs.kitti.kitti_odometry_writer import KittiOdometryWriter
from wayloom.logs.kitti.kitti_raw_writer import KittiRawWriter
from wayloom.logs.ros2.mcap_writer import McapWriter
from wayloom.logs.sidecars.sidecar import SIMULATED_RIG
from wayloom.logs.simulated_truth import FOLDER as TRUTH_FOLDER
from wayloom.logs.types import StatedReceiver
from wayloom.simulation.recording.journal import RECORD_NAME, Journal, check_record, sole_run, write_record
from wayloom.simulation.recording.presets import Preset, chosen_drives, find_preset
from wayloom.simulation.recording.record_drive import Recording, plan_recording, record, route_plan
from wayloom.simulation.recording.truth_files import TruthFolder
from wayloom.simulation.recording.worlds import build_world
from wayloom.simulation.rendering.renderer import World
from wayloom.simulation.traffic.drives import plan_drives
from wayloom.simulation.vehicle.rigs import given_rig, sized_rig
from wayloom.simulation.vehicle.vehicle_settings import VehicleSettings

WRITERS: Final[dict[str, type[DriveWriter]]] = {
    "kitti": KittiOdometryWriter,
    "kitti-raw": KittiRawWriter,
    "kitti-360": Kitti360Writer,
    "euroc": EurocWriter,
    "mcap": McapWriter,
}
SET_UP_SHARE = 0.1
FORMAT_VERSION = 1


@dataclass(frozen=True, slots=True)
class OutputSettings:
    """Settings of the written logs.

    size    "full", "half" or "quarter" of the rigs' images
    format  a key of WRITERS
    truth   also write depth, class and instance of every pixel, and where everything is, to <vehicle>/truth
    """

    size: str = "half"
    format: str = "kitti"
    truth: bool = False


@dataclass(frozen=True, slots=True)
class PresetVariant:
    """Variant of a preset.

    seed    another city than the preset's
    laps    another number than the preset's, for presets that go in laps
    drives  the vehicles to write; all where none is named
    frames  stop each drive after so many frames
    """

    seed: int | None = None
    laps: int | None = None
    drives: tuple[str, ...] = ()
    frames: int | None = None


def simulate(
    preset: str | Preset,
    out_dir: Path,
    output: OutputSettings = OutputSettings(),
    variant: PresetVariant = PresetVariant(),
    threads: int = 1,
    progress: Progress = silent,
    world: World | None = None,
) -> list[Path]:
    """Write drives of a preset to out_dir/<vehicle>; returns their folders. The bytes do not depend on `threads`.

    A folder appears when its drive is whole. A run that was stopped, however that came, goes on where it ended when it is called
    again with the same arguments, and ends with the same bytes; drives that are there are left as they are.

    world   of the preset's city and light at that size, where it is built already
    Raises ConfigError for what is unknown or does not go together; LogError where out_dir holds other drives, or was simulated
    with other settings; ConflictError where another simulation is writing there; OSError, naming the file, where the disk refuses.
    """
    chosen = with_laps(with_seed(find_preset(preset) if isinstance(preset, str) else preset, variant.seed), variant.laps)
    format = output.format
    if format not in WRITERS:
        raise ConfigError(f"unknown format {format!r}", remedy=f"use one of {', '.join(WRITERS)}")
    sized_rig(output.size)
    numbers = chosen_drives(chosen, variant.drives)
    check_formats(chosen, numbers, format)
    settings = run_settings(chosen, output, variant.frames)
    check_record(out_dir, settings)
    paths = [folder_of(out_dir, chosen, number, format) for number in numbers]
    left = [number for number in numbers if not is_done(out_dir, chosen, number, format)]
    if not left:
        return paths
    progress(0.0, "building the city")
    world = build_world(chosen.city, chosen.light, output.size) if world is None else world
    planned = plan_drives(world.city, [route_plan(plan, chosen) for plan in chosen.drives])
    recordings = [plan_recording(chosen, number, planned[number], variant.frames) for number in left]
    out_dir.mkdir(parents=True, exist_ok=True)
    with sole_run(out_dir):
        check_record(out_dir, settings)
        write_record(out_dir, settings)
        total, done = sum(map(len, recordings)), 0
        for recording in recordings:
            for whole in write_drive(out_dir, world, chosen, recording, output, threads):
                last = ", putting the drive together" if whole == len(recording) else ""
                what = f"{recording.plan.vehicle_id}: frame {whole} of {len(recording)}{last}"
                progress(SET_UP_SHARE + (1 - SET_UP_SHARE) * (done + whole) / total, what)
            done += len(recording)
    progress(1.0, "done")
    return paths


def with_seed(preset: Preset, seed: int | None) -> Preset:
    """The preset in the city of another seed."""
    return preset if seed is None else preset.model_copy(update={"city": preset.city.model_copy(update={"seed": seed})})


def with_laps(preset: Preset, laps: int | None) -> Preset:
    """The preset with another number of laps. Raises ConfigError where it does not go in laps."""
    if laps is None:
        return preset
    if preset.laps is None:
        raise ConfigError(f"{preset.name} does not go in laps", record="--laps", remedy="take the preset long, or leave it out")
    return preset.model_copy(update={"laps": laps})


def check_formats(preset: Preset, numbers: tuple[int, ...], format: str) -> None:
    """Raises ConfigError where a vehicle's images have distortion, for which the layout has no place."""
    bent = [preset.drives[number].vehicle_id for number in numbers if preset.drives[number].vehicle.distortion is not None]
    if bent and not WRITERS[format].holds_raw_images:
        holding = ", ".join(key for key, writer in WRITERS.items() if writer.holds_raw_images)
        raise ConfigError(f"the images of {bent[0]} are distorted, {format} holds rectified ones", remedy=f"use {holding}")


def folder_of(out_dir: Path, preset: Preset, number: int, format: str) -> Path:
    """The folder of a drive."""
    plan = preset.drives[number]
    return out_dir / WRITERS[format].folder_name(plan.vehicle_id, plan.vehicle.distortion is not None)


def is_done(out_dir: Path, preset: Preset, number: int, format: str) -> bool:
    """Whether a drive was written by an earlier run. Raises LogError where something else is in its place."""
    path = folder_of(out_dir, preset, number, format)
    if not path.exists() or (path.is_dir() and not any(path.iterdir())):
        return False
    if not path.is_dir() or not (out_dir / RECORD_NAME).is_file():
        raise LogError("exists and is no empty folder", file=path, remedy="remove it or give another path")
    shutil.rmtree(unfinished_folder(path), ignore_errors=True)  # of a run that was killed between its last two steps
    return True


def run_settings(preset: Preset, output: OutputSettings, frames: int | None) -> dict[str, Any]:
    """All settings that the bytes of a run depend on."""
    return {
        "format_version": FORMAT_VERSION,
        "wayloom": __version__,
        "preset": preset.model_dump(mode="json"),
        "size": output.size,
        "format": output.format,
        "truth": output.truth,
        "frames": frames,
    }


def stated_receiver(vehicle: VehicleSettings) -> StatedReceiver:
    """What a vehicle's log says of its GNSS clock."""
    clock = vehicle.clock
    return StatedReceiver() if clock.stated_offset_s is None else StatedReceiver(clock.stated_offset_s, clock.stated_sigma_s)


def write_drive(
    out_dir: Path, world: World, preset: Preset, recording: Recording, output: OutputSettings, threads: int
) -> Iterator[int]:
    """Write one drive; yields the number of finished frames after each."""
    plan, path = recording.plan, folder_of(out_dir, preset, recording.number, output.format)
    vehicle = plan.vehicle
    rig_id = f"{SIMULATED_RIG}{preset.name}-{vehicle.rig_name or plan.vehicle_id}"
    writer = WRITERS[output.format](
        path,
        given_rig(vehicle, output.size),
        rig_id=rig_id,
        vehicle_id=plan.vehicle_id,
        extrinsics=SensorExtrinsics(
            np.array(vehicle.p_cam_gnss_m),
            vehicle.T_cam_imu,
            None if vehicle.lidar is None else vehicle.T_cam_lidar,
            stated_receiver(vehicle),
        ),
        encoding=ImageEncoding(jpeg_quality=vehicle.jpeg_quality, distortion=vehicle.distortion),
        resume=True,
    )
    journal = Journal(unfinished_folder(path) / "journal.txt")
    folder = TruthFolder(writer.folder / TRUTH_FOLDER) if output.truth else None
    try:
        with writer:
            yield from record(writer, journal, world, preset, recording, output.size, folder, threads)
    finally:
        journal.close()
