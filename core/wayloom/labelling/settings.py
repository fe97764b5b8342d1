"""Settings of the labelling. The paper's own form is `PAPER`; the default is what does best on the benchmark."""

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
        description="keyframes before and after the host that vote as well if the point looks alike there; 0: obs(p)",
    )
    likeness_power: float = Field(
        4.0,
        ge=0,
        le=16,
        description="weight: correlation of the point's looks in host and observer to this power; 0: not looked at",
    )
    nearness_power: float = Field(1.0, ge=0, le=4, description="weight: inverse depth in the observer to this power (eq. 3: 1)")
    occlusion_check: bool = Field(False, description="no vote where points that are seen there stand before the projection")
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
    rarity: float = Field(
        0.1,
        ge=0,
        le=1,
        description="a class's votes are divided by its share of the drive's votes to this power, where the network's training did "
        "not weigh rare classes more; 0: not",
    )
    between_keyframes: bool = Field(False, description="the frames between keyframes are labelled and vote as well")


PAPER: Final = LabellingSettings(votes="hard", reach=0, likeness_power=0.0, spread=0.0, rarity=0.0)
"""Equations 2 and 3 as they stand in the paper."""
