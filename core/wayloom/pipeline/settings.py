"""Settings of a whole drive: those of its stages, the network, and where the map's origin lies."""

from typing import Annotated

from pydantic import Field

from wayloom.config.settings import Settings
from wayloom.georeference.settings import GeoReferenceSettings
from wayloom.georeference.types import MapFrame
from wayloom.labelling.settings import LabellingSettings
from wayloom.odometry.settings import OdometrySettings
from wayloom.segmentation.providers import Device
from wayloom.submaps.settings import SubmapSettings

Longitude = Annotated[float, Field(ge=-180.0, le=180.0)]
Latitude = Annotated[float, Field(ge=-90.0, le=90.0)]
Height = Annotated[float, Field(ge=-1000.0, le=20000.0)]


class ProcessSettings(Settings):
    """Settings that `process_drive` and the workers hand to every stage; the catalogue says which part is whose."""

    odometry: OdometrySettings = OdometrySettings()
    labelling: LabellingSettings = LabellingSettings()
    georeference: GeoReferenceSettings = GeoReferenceSettings()
    submaps: SubmapSettings = SubmapSettings()
    model: str | None = Field(None, description="network: a name of the catalogue or an ONNX file; default the built-in one")
    device: Device = Field(
        "auto", description="on what the network runs; auto: the first of CUDA, CoreML, OpenVINO, CPU that is there"
    )
    map_origin: tuple[Longitude, Latitude, Height] | None = Field(
        None, description="origin of the map frame: lon, lat in degrees, ellipsoidal height in m; default the place's own cell"
    )
    rig: str | None = Field(None, description="what is known of rigs: a RIG.toml, or a folder with one named <rig_id>.toml a rig")
    threads: int = Field(1, ge=1, le=64, description="threads of one stage; results do not depend on it")

    def map_frame(self) -> MapFrame | None:
        """The map frame that was asked for, None for the place's own."""
        return None if self.map_origin is None else MapFrame(*self.map_origin)
