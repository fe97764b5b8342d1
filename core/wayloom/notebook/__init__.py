"""Results for notebooks and scripts: drive logs, processed drives and maps as numpy arrays and GeoDataFrames."""

from wayloom.notebook.city_map import Map
from wayloom.notebook.drive import Drive
from wayloom.notebook.opening import open_log, process

__all__ = ["Drive", "Map", "open_log", "process"]
