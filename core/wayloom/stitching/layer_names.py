"""Layers of a fused map by name; the one list that regions, their files and the tiles read."""

from typing import Final

LAYERS: Final = ("static", "parked", "moving", "unconfirmed", "gone")
STATIC, PARKED, MOVING, UNCONFIRMED, GONE = range(len(LAYERS))
UNSERVED: Final = frozenset({LAYERS[MOVING], LAYERS[GONE]})
"""Layers that stay in the regions: where a vehicle happened to drive says nothing of the city, and much of its driver; what has
gone is told by the list of changes."""
OVERLAYS: Final = tuple(name for name in LAYERS[1:] if name not in UNSERVED)
"""The layers that are served beside the static one, each as tiles of its own."""
