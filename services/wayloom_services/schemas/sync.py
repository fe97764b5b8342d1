"""Schemas of the differences between versions, and of what a client that holds tiles gets to hold a version."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

MOST_HELD = 100_000
Digest = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
Layer = Annotated[str, Field(pattern="^[a-z0-9][a-z0-9_-]{0,31}$")]
After = Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]{0,31},\d{1,2},\d{1,8},\d{1,8}$")]


class TileAt(BaseModel):
    """The address of a tile."""

    layer: Layer
    z: int = Field(ge=0, le=24)
    x: int = Field(ge=0, lt=2**24)
    y: int = Field(ge=0, lt=2**24)


class TileThere(TileAt):
    """A tile that a version has. digest: SHA-256 of its bytes."""

    digest: str
    bytes: int


class TileGone(TileAt):
    """A tile that a version has no more; before: its digest."""

    before: str


class TileAnew(TileThere):
    """A tile with other bytes than `before`."""

    before: str


class DiffOut(BaseModel):
    """A page of the tiles in which version `version` differs from `base`. next: `after` of the next page; null on the last."""

    map_id: str
    base: int
    version: int
    added: list[TileThere]
    changed: list[TileAnew]
    removed: list[TileGone]
    next: str | None


class RegionThere(BaseModel):
    """A region of one of two versions: digests of its voxels and of its other files, and of what it was made from."""

    digest: str
    bytes: int
    inputs: str
    files: dict[str, str]


class RegionDiff(BaseModel):
    """A region in which two versions differ; null where a version has none there. bbox: west, south, east, north."""

    east: int
    north: int
    bbox: tuple[float, float, float, float]
    before: RegionThere | None
    after: RegionThere | None


class RegionDiffOut(BaseModel):
    """A page of the regions in which version `version` differs from `base`."""

    map_id: str
    base: int
    version: int
    regions: list[RegionDiff]
    next: str | None


class HeldTile(TileAt):
    """A tile that the client holds."""

    digest: Digest


class SyncIn(BaseModel):
    """Which map a client holds, and which part of which version it wants.

    version  the version that it holds, of the same layers and box (0: nothing); or
    tiles    the tiles that it holds
    to       the version that it wants, the newest by default: name it from the second page on
    layers   those that it wants, all by default
    bbox     west, south, east, north in degrees
    after    `next` of the page before
    """

    model_config = ConfigDict(extra="forbid")

    version: int | None = Field(default=None, ge=0, le=2**31 - 1)
    tiles: list[HeldTile] | None = Field(default=None, max_length=MOST_HELD)
    to: int | None = Field(default=None, ge=1, le=2**31 - 1)
    layers: list[Layer] | None = Field(default=None, max_length=64)
    bbox: tuple[float, float, float, float] | None = None
    limit: int = Field(default=5000, ge=1, le=20_000)
    after: After | None = None


class TileToFetch(TileThere):
    """A tile to fetch; name: its path behind `fetch_from`, and in a folder of tiles."""

    name: str


class TileToDrop(TileAt):
    """A tile to drop, likewise."""

    name: str


class SyncOut(BaseModel):
    """A page of what makes a client's tiles those of `version`: fetch `add` and `replace`, delete `drop`.

    base        the version that the client holds, as far as the server still knows it. 0: what it holds counts for nothing, `add`
                is all of the version, and what the client has beside it is to be dropped. Null: it has told the tiles that it holds
    fetch_from  path of the version's tiles on the server; they never change
    """

    map_id: str
    version: int
    base: int | None
    fetch_from: str
    add: list[TileToFetch]
    replace: list[TileToFetch]
    drop: list[TileToDrop]
    next: str | None
