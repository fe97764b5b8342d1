"""Semantic classes: the 19 Cityscapes train classes, their colours, and which of them move."""

from typing import Final

import numpy as np

CLASS_NAMES: Final = (
    "road", "sidewalk", "building", "wall", "fence", "pole", "traffic light", "traffic sign", "vegetation", "terrain",
    "sky", "person", "rider", "car", "truck", "bus", "train", "motorcycle", "bicycle",
)  # fmt: skip
CLASS_COUNT: Final = len(CLASS_NAMES)
VOID: Final = 255
CLASS_ID: Final = {name: i for i, name in enumerate(CLASS_NAMES)}
MOVING_CLASSES: Final = tuple(CLASS_ID[name] for name in CLASS_NAMES[11:])
"""Persons, riders and vehicles: kept out of the static layer of the map."""
PERSONS: Final = (CLASS_ID["person"], CLASS_ID["rider"])
"""Kept in no submap, cloud or layer."""
SKY: Final = CLASS_ID["sky"]

# Cityscapes' own colours, so that the pictures read like those of the field. (19, 3) RGB.
PALETTE: Final = np.array(
    [
        (128, 64, 128), (244, 35, 232), (70, 70, 70), (102, 102, 156), (190, 153, 153), (153, 153, 153), (250, 170, 30),
        (220, 220, 0), (107, 142, 35), (152, 251, 152), (70, 130, 180), (220, 20, 60), (255, 0, 0), (0, 0, 142), (0, 0, 70),
        (0, 60, 100), (0, 80, 100), (0, 0, 230), (119, 11, 32),
    ],
    dtype=np.uint8,
)  # fmt: skip
PALETTE_WITH_VOID: Final = np.vstack([PALETTE, np.zeros((256 - CLASS_COUNT, 3), np.uint8)])
"""(256, 3) RGB: indexable by any uint8 label, void is black."""
