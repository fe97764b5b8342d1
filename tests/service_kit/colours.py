"""How colours stand off each other: contrast by WCAG 2, distance in OKLab (Ottosson 2020)."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

LMS = np.array([[0.4122, 0.5363, 0.0514], [0.2119, 0.6807, 0.1074], [0.0883, 0.2817, 0.6300]])
LAB = np.array([[0.2105, 0.7936, -0.0041], [1.9780, -2.4286, 0.4506], [0.0259, 0.7828, -0.8087]])
"""Linear sRGB to OKLab, by the cube roots of three cones' answers."""


def distances(palette: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(n, n) between the colours (n, 3) RGB in OKLab, where 0.02 is about what can just be seen."""
    lab = np.cbrt(linear(palette / 255.0) @ LMS.T) @ LAB.T
    return np.asarray(np.linalg.norm(lab[:, None] - lab[None], axis=2))


def apart(palette: NDArray[np.uint8]) -> NDArray[np.float64]:
    """(n,) how far each colour (n, 3) RGB is from the nearest other one, in OKLab."""
    return np.asarray((distances(palette) + 9.0 * np.eye(len(palette))).min(axis=1))


def contrast(one: str, other: str) -> float:
    """Of two CSS colours rgb(r, g, b), by WCAG 2: 1 to 21."""
    low, high = sorted((_luminance(one), _luminance(other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour: str) -> float:
    rgb = np.array([int(part) for part in re.findall(r"\d+", colour)[:3]]) / 255.0
    return float(linear(rgb) @ (0.2126, 0.7152, 0.0722))


def linear(value: Any) -> NDArray[np.float64]:
    """sRGB between 0 and 1 to linear light."""
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
