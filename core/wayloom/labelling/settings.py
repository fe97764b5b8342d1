"""Settings of temporally consistent labelling: the default form, and the paper's own (`PAPER`)."""

from typing import Final, Literal

from pydantic import Field

from wayloom.config.settings import Settings


class LabellingSettings(Settings):
    """Who votes on a point's class, and with what weight."""

    dist_min_m: float = Field(2.0, gt=0, le=100, description="an observation nearer than this does not vote (eq. 3), m along z")
    votes: Literal["hard", "soft"] = Field(
        "soft",
        description="hard: one class a vote (eq. 2); soft: a vote is shared by the network's probabilities, where it gives any",
    )
    reach: int = Field(
        12,
        ge=0,
        le=200,
        description="keyframes before and after the host that vote as well where the patches correlate; 0: obs(p)",
    )
    ncc_power: float = Field(
        4.0,
        ge=0,
        le=16,
        description="weight: normalised cross-correlation of the point's patches in host and observer to this power; 0: off",
    )
    inverse_depth_power: float = Field(
        1.0, ge=0, le=4, description="weight: inverse depth in the observer to this power (eq. 3: 1)"
    )
    occlusion_check: bool = Field(False, description="depth test: no vote where points that are seen there occlude the projection")
    boundary_px: float = Field(
        0.0, ge=0, le=100, description="votes nearer than this to a label boundary count by their distance, px"
    )
    reprojection_px: float = Field(
        0.0,
        ge=0,
        le=100,
        description="votes count half where the depth's sigma moves the projection by so much, px; 0: not looked at",
    )
    spread: float = Field(
        0.015,
        ge=0,
        le=0.2,
        description="points share their votes with those beside them, nearer in space than about this share of the depth; 0: none",
    )
    class_prior_power: float = Field(
        0.1,
        ge=0,
        le=1,
        description="class prior correction: a class's votes are divided by its share of the drive's votes to this power, where "
        "the network's training did not weight rare classes; 0: off",
    )
    right_images: int = Field(
        2, ge=0, le=50, description="the right image of every so many keyframes is labelled and votes beside the left one; 0: none"
    )
    between_keyframes: bool = Field(False, description="the frames between keyframes are labelled and vote as well")


PAPER: Final = LabellingSettings(votes="hard", reach=0, ncc_power=0.0, spread=0.0, class_prior_power=0.0, right_images=1)
"""Equations 2 and 3 as they stand in the paper."""
