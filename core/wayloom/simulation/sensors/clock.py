"""Clock offset and drift of the GNSS/IMU receiver against the cameras."""

import numpy as np
from numpy.typing import NDArray

from wayloom.simulation.vehicle.vehicle_settings import ClockSettings

NS = 1_000_000_000


def stamps_ns(t_s: NDArray[np.float64], start_s: float, start_ns: int, clock: ClockSettings) -> NDArray[np.int64]:
    """(M,) time stamps of the receiver's clock at true times t_s (M,), when the cameras' clock shows start_ns at start_s."""
    since = t_s - start_s
    return start_ns + np.rint((since + clock.offset_s + clock.drift * since) * NS).astype(np.int64)
