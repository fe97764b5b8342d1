"""Ablation of temporally consistent labelling: one row for each setting beside the paper's and the default form."""

from typing import Final

from wayloom.labelling.settings import PAPER, LabellingSettings

ABLATION: Final[dict[str, LabellingSettings]] = {
    "paper, soft votes": PAPER.model_copy(update={"votes": "soft"}),
    "paper, any projection": PAPER.model_copy(update={"reach": 20}),
    "best, hard votes": LabellingSettings(votes="hard"),
    "best, obs(p) alone": LabellingSettings(reach=0),
    "best, no inverse-depth weight": LabellingSettings(inverse_depth_power=0.0),
    "best, occlusion check": LabellingSettings(occlusion_check=True),
    "best, boundaries": LabellingSettings(boundary_px=5.0),
    "best, depth variance": LabellingSettings(reprojection_px=2.0),
    "best, no neighbours": LabellingSettings(spread=0.0),
    "best, no class prior correction": LabellingSettings(class_prior_power=0.0),
    "best, frames between keyframes": LabellingSettings(between_keyframes=True),
}
"""Name of the row to its settings."""
