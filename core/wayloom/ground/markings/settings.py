"""Settings of markings and kerbs."""

from pydantic import Field

from wayloom.config.settings import Settings


class MarkingSettings(Settings):
    """What counts as paint on the road, and of which kind it is."""

    contrast: float = Field(0.22, gt=0.0, description="paint is this share brighter than the road on both its sides, at its core")
    edge_contrast: float = Field(0.11, gt=0.0, description="and this share where it is traced outwards from its core")
    least_sharpness: int = Field(2, ge=1, le=255, description="image pixels a metre below which nothing is looked for, 1/m")
    least_length_m: float = Field(0.35, gt=0.0, description="shortest line, m")
    least_width_m: float = Field(0.05, gt=0.0, description="narrowest line, m")
    most_width_m: float = Field(0.7, gt=0.0, description="widest line and widest bar of a crossing, m")
    solid_m: float = Field(8.0, gt=0.0, description="lines from this length on are solid, shorter ones dashes, m")
    stop_width_m: float = Field(0.25, gt=0.0, description="narrowest stop line, m")
    hidden_gap_m: float = Field(
        2.0, ge=0.0, description="lines that continue each other behind an unseen gap up to this are one, m"
    )
    worn_gap_m: float = Field(0.15, ge=0.0, description="and behind a gap where paint is worn off, m")
    bars: int = Field(3, ge=2, description="fewest bars of a crossing")
    period_m: tuple[float, float] = Field((0.6, 1.7), description="from one bar of a crossing to the next, m")
    symbol_area_m2: tuple[float, float] = Field((0.25, 4.0), description="painted area of an arrow or another symbol, m^2")
    symbol_length_m: tuple[float, float] = Field((0.8, 7.5), description="longest extent of an arrow or another symbol, m")
    least_confidence: float = Field(0.5, ge=0.0, le=1.0, description="markings below this confidence are left out")
    view_slope: float = Field(1.0, ge=0.0, description="a height that is off by 1 m moves the picture by so many metres")


class KerbSettings(Settings):
    """What counts as a kerb."""

    height_m: tuple[float, float] = Field((0.04, 0.25), description="lowest and highest step, m")
    reach_m: float = Field(1.0, gt=0.0, description="how far beside a border the surfaces on both sides are looked at, m")
    shift_m: float = Field(0.4, ge=0.0, description="how far the step may lie from the border of the labels, m")
    window_m: float = Field(1.0, gt=0.0, description="stretch of the border whose profiles are judged together, m")
    sigmas: float = Field(3.0, gt=0.0, description="a step is at least this many of its sigmas high")
    least_length_m: float = Field(1.5, gt=0.0, description="shortest kerb, m")
