"""A made motion whose every derivative exists."""

import numpy as np

from wayloom.simulation.vehicle.vehicle_settings import rotation


class Winding:
    """A body that winds along at about 10 m/s, rolling and pitching, far from the origin."""

    def __init__(self, start_s: float = 20.0, end_s: float = 30.0) -> None:
        self.start_s, self.end_s = start_s, end_s

    def pose(self, t_s: np.ndarray) -> np.ndarray:
        """T_enu_body (M, 4, 4)."""
        out = np.zeros((len(t_s), 4, 4))
        for k, t in enumerate(t_s):
            out[k, :3, :3] = rotation(0.02 * np.sin(1.3 * t), 0.015 * np.sin(2.1 * t + 1), 0.3 * t + 0.4 * np.sin(0.5 * t))
            out[k, :3, 3] = 1200 + 30 * np.sin(0.33 * t), -900 + 4 * t + 25 * np.cos(0.3 * t), 12 + 0.5 * np.sin(0.7 * t)
            out[k, 3, 3] = 1.0
        return out


class Standing(Winding):
    """A body that does not move."""

    def pose(self, t_s: np.ndarray) -> np.ndarray:
        """T_enu_body (M, 4, 4)."""
        return super().pose(np.full(len(t_s), 3.0))
