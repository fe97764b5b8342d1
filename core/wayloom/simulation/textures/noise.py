"""Tileable random fields with the power spectra of natural surfaces."""

import numpy as np
from numpy.typing import NDArray
from scipy import fft

Field = NDArray[np.float32]


def spectral_noise(rng: np.random.Generator, size: int, exponent: float, lowest: float = 0.5) -> Field:
    """(size, size) tileable noise of zero mean and unit spread whose power falls with frequency as 1/f^exponent.

    lowest  cycles per tile under which there is nothing
    """
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.rfftfreq(size)[None]).astype(np.float32) * size
    amplitude = np.zeros_like(f)
    kept = f > max(lowest, 0.5)
    amplitude[kept] = f[kept] ** np.float32(-exponent / 2)
    phase = rng.random(f.shape, dtype=np.float32) * np.float32(2 * np.pi)
    field = fft.irfft2(amplitude * (np.cos(phase) + 1j * np.sin(phase)), s=(size, size))
    return np.asarray((field - field.mean()) / field.std(), np.float32)
