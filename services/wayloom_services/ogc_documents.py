"""Documents of OGC API Features (Part 1: Core, 1.0.1): landing page, conformance, collections, pages of features."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import quote, urlencode

from wayloom.store.tables.maps import MapVersion
from wayloom_services.ogc_collections import COLLECTIONS, Feature

GEOJSON: Final = "application/geo+json"
JSON: Final = "application/json"
OPENAPI: Final = "application/vnd.oai.openapi+json;version=3.1"
CONFORMANCE: Final = tuple(f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" for name in ("core", "geojson"))
CRS: Final = "http://www.opengis.net/def/crs/OGC/0/CRS84h"
"""Longitude, latitude, ellipsoidal height."""
FLAT_CRS: Final = "http://www.opengis.net/def/crs/OGC/1.3/CRS84"
Document = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Addresses:
    """home: of the landing page; api: of the API's definition. Without a slash at the end."""

    home: str
    api: str

    def collection(self, name: str) -> str:
        """Of a collection."""
        return f"{self.home}/collections/{name}"


def _link(href: str, rel: str, kind: str = JSON, title: str | None = None) -> Document:
    return {"href": href, "rel": rel, "type": kind, **({} if title is None else {"title": title})}


def landing_page(at: Addresses, version: MapVersion) -> Document:
    """Where everything else is."""
    return {
        "title": f"wayloom: {version.map_id}, version {version.version}",
        "description": "Features of a map made of drives",
        "links": [
            _link(at.home, "self", title="This document"),
            _link(at.api, "service-desc", OPENAPI, "The API"),
            _link(f"{at.home}/conformance", "conformance", title="What it conforms to"),
            _link(f"{at.home}/collections", "data", title="Collections"),
        ],
    }


def collections_document(at: Addresses, version: MapVersion) -> Document:
    """Every collection."""
    own = [_link(f"{at.home}/collections", "self")]
    return {"links": own, "collections": [collection_document(at, version, name) for name in COLLECTIONS]}


def collection_document(at: Addresses, version: MapVersion, name: str) -> Document:
    """One collection."""
    extent = {} if version.bounds is None else {"extent": {"spatial": {"bbox": [version.bounds], "crs": FLAT_CRS}}}
    return {
        "id": name,
        "title": COLLECTIONS[name].title,
        "description": COLLECTIONS[name].description,
        **extent,
        "itemType": "feature",
        "crs": [CRS],
        "links": [_link(at.collection(name), "self"), _link(f"{at.collection(name)}/items", "items", GEOJSON)],
    }


def items_document(
    at: Addresses, name: str, features: Sequence[Feature], given: Mapping[str, str], following: str | None
) -> Document:
    """A page of features. given: the parameters of the request; following: where the next page begins."""
    items = f"{at.collection(name)}/items"
    links = [_link(items + (f"?{urlencode(given)}" if given else ""), "self", GEOJSON), _link(at.collection(name), "collection")]
    if following is not None:
        links.append(_link(f"{items}?{urlencode({**given, 'after': following})}", "next", GEOJSON))
    whole = {} if following is not None or "after" in given else {"numberMatched": len(features)}
    stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    about = {"numberReturned": len(features), **whole, "timeStamp": stamp, "links": links}
    return {"type": "FeatureCollection", "features": [*features], **about}


def item_document(at: Addresses, name: str, feature: Feature) -> Document:
    """One feature."""
    own = f"{at.collection(name)}/items/{quote(str(feature['id']), safe='')}"
    return {**feature, "links": [_link(own, "self", GEOJSON), _link(at.collection(name), "collection")]}
