"""Presets of `wayloom simulate`: a city, its light, and its vehicles with their routes."""

from typing import Final, Self

from pydantic import Field, model_validator

from wayloom.config.settings import Settings
from wayloom.errors import ConfigError
from wayloom.geodesy.map_frame import MapFrame
from wayloom.logs.types import FixType
from wayloom.simulation.city.city_settings import CitySettings
from wayloom.simulation.rendering.light import LightSettings
from wayloom.simulation.vehicle.rig_faults import FAULTS
from wayloom.simulation.vehicle.vehicle_settings import (
    ClockSettings,
    ExposureSettings,
    GlareSettings,
    GnssBurst,
    GnssSettings,
    GnssStep,
    ImuSettings,
    LidarSettings,
    LightChange,
    SensorSettings,
    VehicleSettings,
    gnss_steps,
)

CITY_ORIGIN: Final = MapFrame(lon_deg=3.52, lat_deg=55.49, height_m=45.0)
"""Where the city's zero lies on Earth: over the Dogger Bank in the North Sea, so that nobody takes it for a real place."""
START_NS: Final = 1_780_300_800_000_000_000
"""The city's time zero: 2026-06-01 08:00 UTC."""


class DrivePlan(Settings):
    """One drive of one vehicle."""

    vehicle_id: str = Field(pattern=r"^[a-z][a-z0-9-]{0,40}$")
    nodes: tuple[int, ...] = Field(min_length=2, description="crossings passed, row * columns + column")
    closed: bool = Field(default=False, description="from the last crossing back to the first, and to the start")
    reference: int = Field(default=0, description="place in `nodes` of the crossing from which the start is measured")
    before_m: float = Field(default=30.0, description="start this far before that crossing, m along the lane")
    frames: int | None = Field(default=None, ge=2, le=100_000, description="none: the whole way of a closed drive, once")
    start_s: float = Field(ge=0, description="s after the city's time zero")
    fastest_m_s: float = Field(default=12.5, gt=0, le=40)
    vehicle: VehicleSettings = VehicleSettings()

    @model_validator(mode="after")
    def _has_an_end(self) -> Self:
        if self.frames is None and not self.closed:
            raise ValueError("a drive that does not close needs a number of frames")
        return self


class Preset(Settings):
    """A city and its drives. laps: number of laps of each closed drive, without traffic; later laps repeat the first's images."""

    name: str
    about: str
    city: CitySettings
    light: LightSettings = LightSettings()
    rate_hz: float = Field(default=10.0, gt=0, le=100)
    laps: int | None = Field(default=None, ge=1, le=100_000, description="none: every frame is drawn")
    drives: tuple[DrivePlan, ...] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len({plan.vehicle_id for plan in self.drives}) < len(self.drives):
            raise ValueError("two drives have the same vehicle_id")
        if self.laps is not None and not (all(plan.closed and plan.frames is None for plan in self.drives) and self._is_still()):
            raise ValueError("laps need whole closed drives, and a city without traffic and people")
        return self

    def _is_still(self) -> bool:
        return self.city.traffic == 0 and self.city.people == 0


NONE, SINGLE, FLOAT, FIXED = FixType.NONE, FixType.SINGLE, FixType.FLOAT, FixType.FIXED
OUTAGE: Final = GnssSettings(steps=gnss_steps((0.0, FIXED), (0.40, FLOAT), (0.50, NONE), (0.62, SINGLE), (0.72, FIXED)))
LOOP_NODES: Final = (6, 7, 12, 11)
"""Around the block in the middle of 5 x 5 crossings: about 300 m."""
LOOP: Final = DrivePlan(
    vehicle_id="car-1", nodes=LOOP_NODES, closed=True, start_s=278.0, vehicle=VehicleSettings(imu=ImuSettings())
)
LOOP_TRAFFIC: Final = 0.4
"""So little that one comes around without waiting."""

DEMO: Final = Preset(
    name="demo",
    about="Two vehicles in the same streets: one turns a corner, the other comes the opposite way and goes straight on.",
    city=CitySettings(seed=7),
    drives=(
        DrivePlan(vehicle_id="car-1", nodes=(5, 6, 7, 12), reference=2, before_m=58.0, frames=72, start_s=56.0),
        DrivePlan(
            vehicle_id="car-2",
            nodes=(9, 8, 7, 6, 5),
            reference=2,
            before_m=26.0,
            frames=72,
            start_s=404.0,
            vehicle=VehicleSettings(p_cam_gnss_m=(-0.20, -0.48, -1.25), right=SensorSettings(gain=1.02), gnss=OUTAGE),
        ),
    ),
)
LOOP_PRESET: Final = Preset(
    name="loop",
    about="One vehicle around a block and back to its start, about 300 m, with IMU, in everyday light.",
    city=CitySettings(seed=3, traffic=LOOP_TRAFFIC),
    drives=(LOOP,),
)
HARD: Final = Preset(
    name="hard",
    about="The way of `loop` in a city whose blocks are all alike: places that look the same and are not.",
    city=CitySettings(seed=3, traffic=LOOP_TRAFFIC, hard=True),
    drives=(LOOP.model_copy(update={"start_s": 140.0}),),
)
CHANGED: Final = Preset(
    name="changed",
    about="The way of `loop` in the same city, later: some signs, poles, parked cars and one facade differ.",
    city=CitySettings(seed=3, traffic=LOOP_TRAFFIC, changed=True),
    drives=(LOOP,),
)
FLEET: Final = Preset(
    name="fleet",
    about="Five vehicles with different rigs and receivers on overlapping ways, in both directions.",
    city=CitySettings(seed=19, columns=6, rows=6, traffic=0.3),
    drives=(
        DrivePlan(
            vehicle_id="van-1", nodes=(6, 7, 8, 9, 15, 21), reference=1, before_m=55.0, frames=260, start_s=76.0,
            vehicle=VehicleSettings(camera_height_m=2.1, p_cam_gnss_m=(-0.2, -0.5, -1.2), imu=ImuSettings()),
        ),
        DrivePlan(
            vehicle_id="van-2", nodes=(15, 9, 8, 7, 6), reference=1, before_m=45.0, frames=220, start_s=192.0,
            vehicle=VehicleSettings(camera_height_m=2.1, gnss=OUTAGE, right=SensorSettings(gain=1.04, vignette=0.5)),
        ),
        DrivePlan(
            vehicle_id="taxi-1", nodes=(8, 14, 13, 7), closed=True, frames=360, start_s=264.0,
            vehicle=VehicleSettings(
                rig="kitti",
                gnss=GnssSettings(
                    rate_hz=5.0, steps=gnss_steps((0.0, SINGLE)), bursts=(GnssBurst(share=0.5, duration_s=4.0, size_m=12.0),)
                ),
            ),
        ),
        DrivePlan(
            vehicle_id="taxi-2", nodes=(13, 14, 8, 7), closed=True, frames=360, start_s=374.0,
            vehicle=VehicleSettings(
                rig="kitti",
                exposure=ExposureSettings(metering="centre", time_constant_s=0.4),
                clock=ClockSettings(offset_s=0.02, drift=2e-6),
                gnss=GnssSettings(
                    rate_hz=5.0,
                    steps=(
                        GnssStep(share=0.0, fix=FLOAT),
                        GnssStep(share=0.3, fix=FLOAT, stated_ratio=0.2),
                        GnssStep(share=0.5, fix=FIXED),
                    ),
                ),
            ),
        ),
        DrivePlan(
            vehicle_id="bus-1", nodes=(19, 20, 14, 8, 2), reference=1, before_m=60.0, frames=240, start_s=498.0, fastest_m_s=9.0,
            vehicle=VehicleSettings(
                camera_height_m=2.7,
                camera_roll_pitch_yaw_rad=(0.0, 0.04, 0.0),
                jpeg_quality=92,
                left=SensorSettings(vignette=0.6),
                right=SensorSettings(gain=0.94, vignette=0.45, gamma_ratio=1.03),
                motion_blur=True,
                clock=ClockSettings(offset_s=-0.008),
                gnss=GnssSettings(steps=gnss_steps((0.0, FIXED), (0.3, NONE))),
                imu=ImuSettings(rate_hz=200.0),
            ),
        ),
    ),
)  # fmt: skip
SCANNER: Final = VehicleSettings(lidar=LidarSettings(), imu=ImuSettings(), right=SensorSettings(gain=1.02))
BENCHMARK: Final = Preset(
    name="benchmark",
    about="Three drives with LiDAR through streets that no network was trained on: labels of images and of points.",
    city=CitySettings(seed=31, columns=7, rows=6),
    drives=(
        DrivePlan(
            vehicle_id="seq-0", nodes=(8, 9, 10, 11, 18, 25), reference=1, before_m=50.0, frames=240, start_s=52.0, vehicle=SCANNER
        ),
        DrivePlan(
            vehicle_id="seq-1", nodes=(33, 26, 25, 24, 23), reference=1, before_m=45.0, frames=280, start_s=100.0, vehicle=SCANNER
        ),
        DrivePlan(vehicle_id="seq-2", nodes=(15, 16, 23, 22), closed=True, frames=300, start_s=628.0, vehicle=SCANNER),
    ),
)
PHOTOMETRY: Final = Preset(
    name="photometry",
    about="A low sun, quick exposure control, sides that differ, glare, a tunnel's darkness, open shutters.",
    city=CitySettings(seed=23, traffic=0.6),
    light=LightSettings(sun_azimuth_deg=12.0, sun_elevation_deg=14.0, sun_strength=3.4, cloud_cover=0.25, haze_per_m=0.004),
    drives=(
        DrivePlan(
            vehicle_id="car-1", nodes=(5, 6, 7, 8, 13), reference=1, before_m=50.0, frames=180, start_s=54.0,
            vehicle=VehicleSettings(
                right=SensorSettings(gain=1.18, offset=3.0, gamma_ratio=1.08, vignette=1.2, vignette_centre=(0.1, -0.05)),
                exposure=ExposureSettings(
                    time_constant_s=0.25, compensation=1.0, light_changes=(LightChange(from_s=6.0, to_s=9.0, factor=0.12),)
                ),
                glare=GlareSettings(veil=0.05, sun=0.8),
                motion_blur=True,
            ),
        ),
        DrivePlan(
            vehicle_id="car-2", nodes=(8, 7, 6, 5), reference=1, before_m=50.0, frames=150, start_s=348.0,
            vehicle=VehicleSettings(
                exposure=ExposureSettings(time_constant_s=0.4, each_for_itself=True, logged=True),
                right=SensorSettings(gain=0.85, noise=2.5),
                left=SensorSettings(noise=2.5),
                glare=GlareSettings(veil=0.02, sun=0.4),
            ),
        ),
    ),
)  # fmt: skip
MOVERS: Final = Preset(
    name="movers",
    about="Rush hour: moving vehicles and people fill the image.",
    city=CitySettings(seed=5, traffic=4.0, people=4.0),
    drives=(
        DrivePlan(
            vehicle_id="car-1", nodes=(15, 16, 17, 18, 19), reference=2, before_m=70.0, frames=150, start_s=60.0, fastest_m_s=8.0,
            vehicle=VehicleSettings(imu=ImuSettings()),
        ),
        DrivePlan(
            vehicle_id="car-2", nodes=(2, 7, 12, 17, 22), reference=2, before_m=70.0, frames=150, start_s=378.0, fastest_m_s=8.0
        ),
    ),
)  # fmt: skip
RIG_WAYS: Final = (
    ((5, 6, 7, 12, 17), 2, 55.0, 58.0),
    ((17, 12, 11, 6, 7), 1, 45.0, 134.0),
    ((10, 11, 12, 13, 14), 1, 40.0, 218.0),
    ((8, 7, 6, 11, 16), 2, 60.0, 294.0),
    ((22, 17, 12, 7, 2), 1, 40.0, 374.0),
)
"""Crossings, reference, metres before it, start time: a turn left, two turns, a roundabout, a turn late, straight on."""
RIG_DRIVES: Final = {"lens": 5, "perfect": 5, "worn": 3, "rows": 2, "offset": 2}
RIG: Final = Preset(
    name="rig",
    about="Rigs whose calibration is a little wrong, each in its own way, and a perfect one: straight ways and turns.",
    city=CitySettings(seed=13, traffic=0.3),
    drives=tuple(
        DrivePlan(
            vehicle_id=f"{fault}-{number}", nodes=nodes, reference=reference, before_m=before_m, frames=120, start_s=start_s,
            vehicle=VehicleSettings(right_lens=FAULTS[fault], rig_name=fault),
        )
        for fault, count in RIG_DRIVES.items()
        for number, (nodes, reference, before_m, start_s) in enumerate(RIG_WAYS[:count], start=1)
    ),
)  # fmt: skip
GRID_WAYS: Final = {
    "fixed": (
        ((6, 7, 8, 9, 10, 11), 104.0), ((23, 22, 21, 20, 19, 18), 204.0), ((2, 8, 14, 20, 26, 32), 248.0),
        ((3, 9, 15, 16, 17), 388.0),
    ),
    "outage": (
        ((11, 10, 9, 8, 7, 6), 455.0), ((4, 10, 16, 22, 28, 34), 556.0), ((24, 25, 26, 20, 14, 8), 688.0),
        ((12, 13, 14, 15, 16, 17), 785.0),
    ),
    "float": (
        ((24, 25, 26, 27, 28, 29), 855.0), ((33, 27, 21, 15, 9, 3), 988.0), ((17, 16, 15, 14, 13, 12), 1040.0),
        ((6, 7, 13, 19, 25, 31), 1148.0),
    ),
    "single": (
        ((18, 19, 20, 21, 22, 23), 1285.0), ((31, 25, 19, 13, 7, 1), 1370.0), ((29, 28, 27, 26, 25, 24), 1455.0),
        ((34, 28, 22, 21, 20), 1564.0),
    ),
    "none": (
        ((32, 26, 20, 14, 8, 2), 1655.0), ((12, 13, 14, 15, 16, 17), 1804.0), ((3, 9, 15, 21, 27, 33), 1872.0),
        ((11, 10, 16, 22, 28, 34), 2000.0),
    ),
}  # fmt: skip
"""Crossings, and start time, of each vehicle's ways through the four streets each way in the middle of the city."""
GRID_VEHICLES: Final = {
    "fixed": VehicleSettings(camera_height_m=2.1, p_cam_gnss_m=(-0.2, -0.5, -1.2), imu=ImuSettings()),
    "outage": VehicleSettings(camera_height_m=2.1, gnss=OUTAGE, right=SensorSettings(gain=1.04, vignette=0.5)),
    "float": VehicleSettings(
        rig="kitti", right_lens=FAULTS["worn"], gnss=GnssSettings(rate_hz=5.0, steps=gnss_steps((0.0, FLOAT)))
    ),
    "single": VehicleSettings(
        right_lens=FAULTS["rows"], exposure=ExposureSettings(metering="centre", time_constant_s=0.4),
        gnss=GnssSettings(rate_hz=5.0, steps=gnss_steps((0.0, SINGLE))),
    ),
    "none": VehicleSettings(camera_height_m=2.7, jpeg_quality=92, motion_blur=True, gnss=None, imu=ImuSettings()),
}  # fmt: skip
GRID: Final = Preset(
    name="grid",
    about="Five vehicles, each with a receiver of its own kind, four times each through a grid of streets, in both directions.",
    city=CitySettings(seed=29, columns=6, rows=6, traffic=0.6),
    drives=tuple(
        DrivePlan(
            vehicle_id=f"{kind}-{number}", nodes=nodes, reference=1, before_m=45.0, frames=200, start_s=start_s,
            vehicle=GRID_VEHICLES[kind].model_copy(update={"rig_name": kind}),
        )
        for kind, ways in GRID_WAYS.items()
        for number, (nodes, start_s) in enumerate(ways, start=1)
    ),
)  # fmt: skip
LONG: Final = Preset(
    name="long",
    about="The way of `loop` without traffic, drawn once and driven for any number of laps (--laps).",
    city=CitySettings(seed=3, traffic=0.0, people=0.0),
    laps=3,
    drives=(LOOP.model_copy(update={"vehicle": VehicleSettings(imu=ImuSettings(), exposure=ExposureSettings(compensation=0.0))}),),
)
PRESETS: Final = {
    preset.name: preset
    for preset in (DEMO, LOOP_PRESET, FLEET, BENCHMARK, HARD, CHANGED, PHOTOMETRY, MOVERS, RIG, GRID, LONG)
}  # fmt: skip


def find_preset(name: str) -> Preset:
    """The preset of that name. Raises ConfigError that lists the known ones."""
    if name not in PRESETS:
        raise ConfigError(f"unknown preset {name!r}", remedy=f"use one of {', '.join(PRESETS)}")
    return PRESETS[name]


def chosen_drives(preset: Preset, names: tuple[str, ...]) -> tuple[int, ...]:
    """Indices in `preset.drives` of the vehicles named; all where none is. Raises ConfigError for an unknown one."""
    known = [plan.vehicle_id for plan in preset.drives]
    unknown = [name for name in names if name not in known]
    if unknown:
        raise ConfigError(f"no drive {unknown[0]!r} in {preset.name}", record="--drives", remedy=f"use some of {', '.join(known)}")
    return tuple(i for i, name in enumerate(known) if not names or name in names)
