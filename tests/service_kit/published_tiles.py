"""Made-up tiles, published as versions of a map in a service's own database and blob store."""

from pathlib import Path

from wayloom.store import map_versions, maps
from wayloom.store.blobs import BlobStore
from wayloom.store.database import Database
from wayloom.store.folders import Folders
from wayloom.store.map_versions import NewVersion, TileEntry, TileKey
from wayloom.tiles.descriptions import SUFFIXES

MEDIA_TYPES = {
    "semantic": "image/png",
    "points": "application/vnd.wayloom.points",
    "markings": "application/vnd.mapbox-vector-tile",
}
Tiles = dict[TileKey, bytes]


class PublishedMap:
    """A map whose versions are dictionaries of tiles."""

    def __init__(self, data: Path, map_id: str = "city", kept: int = 5) -> None:
        self.map_id, self._kept = map_id, kept
        self.database = Database(f"sqlite:///{data / 'wayloom.db'}")
        self._blobs = BlobStore(Folders(data).blobs)
        self.versions: list[Tiles] = []
        with self.database.write() as session:
            maps.ensure_map(session, map_id)

    def publish(self, tiles: Tiles) -> int:
        """The next version has these tiles."""
        before = self.versions[-1] if self.versions else {}
        new = [
            TileEntry(*key, self._blobs.put(content), MEDIA_TYPES[key[0]], len(content))
            for key, content in sorted(tiles.items())
            if before.get(key) != content
        ]
        said = NewVersion(
            len(self.versions), (8.5, 49.5, 0.0), (), 0, (8.0, 49.0, 8.1, 49.1), new, sorted(before.keys() - tiles.keys())
        )
        with self.database.write() as session:
            number = map_versions.publish(session, self.map_id, said, self._kept)
        self.versions.append(dict(tiles))
        return number

    def files(self, number: int, *layers: str) -> dict[str, bytes]:
        """The tiles of a version by their paths in a folder."""
        return {
            f"{layer}/{z}/{x}/{y}{SUFFIXES[layer]}": content
            for (layer, z, x, y), content in self.versions[number - 1].items()
            if not layers or layer in layers
        }
