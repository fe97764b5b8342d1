"""The nested settings: `ProcessSettings` of one drive's stages, `WayloomSettings` of everything that a settings file may say."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

from pydantic import Field

from wayloom.config.gate import GateSettings
from wayloom.config.service import ServiceSettings
from wayloom.config.settings import Settings
from wayloom.config.sources import Loaded, Option, load
from wayloom.dense.settings import LookSettings
from wayloom.geodesy.map_frame import MapFrame
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.ground.areas.settings import AreaSettings
from wayloom.ground.markings.settings import KerbSettings, MarkingSettings
from wayloom.ground.settings import GroundSettings
from wayloom.labelling.settings import LabellingSettings
from wayloom.loops.settings import LoopSettings
from wayloom.objects.settings import ObjectFusionSettings, ObjectSettings
from wayloom.odometry.settings import OdometrySettings
from wayloom.places.settings import PlaceSettings
from wayloom.segmentation.settings import SegmentationSettings
from wayloom.stitching.meeting_settings import MeetingSettings
from wayloom.stitching.settings import CityGraphSettings, MergeSettings
from wayloom.submaps.settings import SubmapSettings
from wayloom.tiles.settings import TileSettings

Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Height = Annotated[float, Field(ge=-1000.0, le=20000.0)]
TABLES: Final = frozenset(
    {"odometry", "segmentation", "labelling", "places", "looks", "loops", "georeference", "submaps", "ground", "objects"}
)
"""Of `ProcessSettings`: those of single stages."""


class ProcessSettings(Settings):
    """Settings that `process_drive` and the workers hand to every stage: one table a stage, and what several stages share."""

    threads: int = Field(1, ge=1, le=64, description="threads of one stage; results do not depend on it")
    rig: Path | None = Field(None, description="what is known of rigs: a RIG.toml, or a folder with one named <rig_id>.toml a rig")
    map_origin: tuple[Longitude, Latitude, Height] | None = Field(
        None,
        description="LON,LAT,HEIGHT of the map frame's origin: degrees, degrees, ellipsoidal metres; default the place's own cell",
    )
    geoid: Path | None = Field(
        None, description="geoid grid of PROJ, .gtx or .tif: exported clouds state heights above it; default ellipsoidal heights"
    )
    dense: bool = Field(False, description="`wayloom process` also writes dense.laz, dense points of what stands beside the road")
    odometry: OdometrySettings = OdometrySettings()
    segmentation: SegmentationSettings = SegmentationSettings()
    labelling: LabellingSettings = LabellingSettings()
    places: PlaceSettings = PlaceSettings()
    looks: LookSettings = LookSettings()
    loops: LoopSettings = LoopSettings()
    georeference: GeoReferenceSettings = GeoReferenceSettings()
    submaps: SubmapSettings = SubmapSettings()
    ground: GroundSettings = GroundSettings()
    markings: MarkingSettings = MarkingSettings()
    kerbs: KerbSettings = KerbSettings()
    objects: ObjectSettings = ObjectSettings()
    object_fusion: ObjectFusionSettings = ObjectFusionSettings()

    def map_frame(self) -> MapFrame | None:
        """The map frame that was asked for, None for the place's own."""
        return None if self.map_origin is None else MapFrame(*self.map_origin)


def with_asked(settings: ProcessSettings, asked: Mapping[str, Mapping[str, Any]]) -> ProcessSettings:
    """The settings with some values of some tables replaced. Raises ValidationError, and KeyError for what is no table."""
    tables = {name: getattr(settings, name) for name in asked if name in TABLES}
    if unknown := sorted(asked.keys() - tables.keys()):
        raise KeyError(f"no tables of a drive's settings: {', '.join(unknown)}")
    return settings.model_copy(update={name: type(own)(**{**own.model_dump(), **asked[name]}) for name, own in tables.items()})


class WayloomSettings(ServiceSettings, ProcessSettings):
    """All settings: those of a drive's stages, of the map's, and of the service."""

    gate: GateSettings = GateSettings()
    areas: AreaSettings = AreaSettings()
    merge: MergeSettings = MergeSettings()
    tiles: TileSettings = TileSettings()
    meetings: MeetingSettings = MeetingSettings()
    city_graph: CityGraphSettings = CityGraphSettings()

    def of_drives(self) -> ProcessSettings:
        """The part that a drive's stages are told: no address, no key."""
        return ProcessSettings(**{name: getattr(self, name) for name in ProcessSettings.model_fields})


def load_settings(config: Path | None = None, *options: Option, **defaults: object) -> Loaded[WayloomSettings]:
    """The settings in force: defaults, settings file, environment, options. Raises ConfigError that names where a bad value stands.

    config   : TOML file; None takes the one that WAYLOOM_CONFIG names, if any
    defaults : of a command, where they differ from the model's
    """
    return load(WayloomSettings, config, options, defaults)
