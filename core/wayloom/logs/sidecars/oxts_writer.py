"""Writer of KITTI's `oxts` folder, in the layout that `wayloom.logs.sidecars.oxts` reads."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from wayloom.files.atomic import write_atomically
from wayloom.files.timestamps import wall_clock_from_ns
from wayloom.logs.sidecars.oxts import Field
from wayloom.logs.types import FixType

POSMODE_OF_FIX = {FixType.NONE: 0, FixType.SINGLE: 3, FixType.FLOAT: 5, FixType.FIXED: 6}
Triple = tuple[float, float, float]
ZERO: Triple = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class OxtsPacket:
    """One packet of the GNSS/INS unit.

    t_ns                 int64 ns, on the clock of the frames
    lon_lat_height       degrees, degrees, ellipsoidal m
    sigma_m              of east and of north; the reader takes twice that for up. A packet without a fix says over 10 m: under
                         that the reader takes it for a place that the unit bridged by inertia
    roll_pitch_yaw       rad, KITTI's angles: yaw 0 is east, counter-clockwise; x forward, y left, z up
    velocity_enu         m/s
    specific_force       m/s^2, in the unit's axes
    angular_rate         rad/s, in the unit's axes
    """

    t_ns: int
    lon_lat_height: Triple
    sigma_m: float
    fix: FixType = FixType.FIXED
    roll_pitch_yaw: Triple = ZERO
    velocity_enu: Triple = ZERO
    specific_force: Triple = (0.0, 0.0, 9.81)
    angular_rate: Triple = ZERO
    satellites: int = 10


def packet_text(packet: OxtsPacket) -> str:
    """The 30 numbers of a packet as KITTI orders them; numbers are read back exactly."""
    values = np.zeros(len(Field))
    lon, lat, height = packet.lon_lat_height
    east, north, up = packet.velocity_enu
    c, s = np.cos(packet.roll_pitch_yaw[2]), np.sin(packet.roll_pitch_yaw[2])
    values[Field.LAT : Field.ALT + 1] = lat, lon, height
    values[Field.ROLL : Field.YAW + 1] = packet.roll_pitch_yaw
    values[Field.VN : Field.VU + 1] = north, east, c * east + s * north, c * north - s * east, up
    values[Field.AX : Field.AZ + 1] = values[Field.AF : Field.AU + 1] = packet.specific_force
    values[Field.WX : Field.WZ + 1] = values[Field.WF : Field.WU + 1] = packet.angular_rate
    values[Field.POS_ACCURACY], values[Field.VEL_ACCURACY] = packet.sigma_m, 0.05
    counts = (4, packet.satellites, POSMODE_OF_FIX[packet.fix], 4, 0)
    return " ".join([*(repr(float(value)) for value in values[: Field.NAVSTAT]), *(str(count) for count in counts)]) + "\n"


class OxtsWriter:
    """Writes packets as they come; `finish` writes their time stamps."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._stamps: list[str] = []
        (folder / "data").mkdir(parents=True)

    def add(self, packet: OxtsPacket) -> None:
        """Write the next packet."""
        write_atomically(self.folder / "data" / f"{len(self._stamps):010d}.txt", packet_text(packet).encode())
        self._stamps.append(wall_clock_from_ns(packet.t_ns) + "\n")

    def finish(self) -> None:
        """Write timestamps.txt."""
        write_atomically(self.folder / "timestamps.txt", "".join(self._stamps).encode())
