"""Endpoints of OGC API Features (Part 1: Core), of a map's newest version and of each that is kept."""

from typing import Annotated, Any, Final

from fastapi import APIRouter, Depends, Path, Request
from fastapi.responses import JSONResponse

from wayloom.store import maps
from wayloom.store.tables.maps import MapVersion
from wayloom_services import ogc_documents as documents
from wayloom_services.context import Service, ServiceDep, require_key
from wayloom_services.drives import PROBLEMS
from wayloom_services.errors import Problem, ProtocolError
from wayloom_services.maps import MapId, Number
from wayloom_services.ogc_collections import COLLECTIONS, Collection
from wayloom_services.ogc_documents import GEOJSON, Addresses
from wayloom_services.ogc_queries import ItemsQuery, read_query, refuse_unknown

Name = Annotated[str, Path(pattern="^[a-z]{1,32}$", description=f"of a collection: {', '.join(COLLECTIONS)}")]
FeatureId = Annotated[str, Path(min_length=1, max_length=128)]
REFUSED: Final[dict[int | str, dict[str, Any]]] = {
    400: {"model": Problem, "description": "a parameter that there is not, or a value that is none"},
    404: {"model": Problem, "description": "no such map, version, collection or feature"},
    410: {"model": Problem, "description": "the version held a drive that was removed"},
}
FEATURES: Final[dict[int | str, dict[str, Any]]] = {200: {"content": {GEOJSON: {}}}}


class Features(JSONResponse):
    """GeoJSON."""

    media_type = GEOJSON


def of_map(map_id: MapId, service: ServiceDep, request: Request) -> "Asked":
    """The newest version."""
    return Asked(service, request, map_id, None)


def of_version(map_id: MapId, number: Number, service: ServiceDep, request: Request) -> "Asked":
    """A version by its number."""
    return Asked(service, request, map_id, number)


class Asked:
    """A request for something of a version of a map. number: None for the newest."""

    def __init__(self, service: Service, request: Request, map_id: str, number: int | None) -> None:
        self.service, self.request = service, request
        self._map_id, self._number = map_id, number

    @property
    def addresses(self) -> Addresses:
        """Under which the requester finds the rest."""
        of = f"/versions/{self._number}" if self._number is not None else ""
        base = f"{self.request.base_url}v1"
        return Addresses(f"{base}/maps/{self._map_id}{of}/ogc", f"{base}/openapi.json")

    async def version(self) -> MapVersion:
        """Raises NotFoundError, WithdrawnError."""
        return await self.service.read(lambda session: maps.version(session, self._map_id, self._number))


def collection_of(name: str) -> Collection:
    """Raises ProtocolError that lists the known ones."""
    if name not in COLLECTIONS:
        raise ProtocolError(404, "not-found", f"there is no collection {name!r}; there are {', '.join(COLLECTIONS)}")
    return COLLECTIONS[name]


def _router(asked: Any, prefix: str) -> APIRouter:
    """The endpoints for versions that `asked` finds."""
    router = APIRouter(prefix=prefix, tags=["ogc"], dependencies=[Depends(require_key)], responses=PROBLEMS | REFUSED)
    AskedDep = Annotated[Asked, Depends(asked)]

    @router.get("")
    async def landing_page(one: AskedDep) -> dict[str, Any]:
        """OGC API Features: where conformance, collections and the API's definition are."""
        refuse_unknown(one.request)
        return documents.landing_page(one.addresses, await one.version())

    @router.get("/conformance")
    async def conformance(one: AskedDep) -> dict[str, Any]:
        """The requirement classes that it conforms to."""
        refuse_unknown(one.request)
        await one.version()
        return {"conformsTo": [*documents.CONFORMANCE]}

    @router.get("/collections")
    async def collections(one: AskedDep) -> dict[str, Any]:
        """The collections: objects, areas, markings, kerbs, tracks, changes."""
        refuse_unknown(one.request)
        return documents.collections_document(one.addresses, await one.version())

    @router.get("/collections/{name}")
    async def collection(name: Name, one: AskedDep) -> dict[str, Any]:
        """One collection."""
        refuse_unknown(one.request)
        collection_of(name)
        return documents.collection_document(one.addresses, await one.version(), name)

    @router.get("/collections/{name}/items", response_class=Features, responses=FEATURES)
    async def items(name: Name, query: Annotated[ItemsQuery, Depends()], one: AskedDep) -> Features:
        """Features of a collection, page by page: links of rel `next` lead through all of them."""
        found, wanted = collection_of(name), read_query(one.request, query)
        version = await one.version()
        features, following = await one.service.in_thread(lambda: found.page(one.service, version, wanted))
        return Features(documents.items_document(one.addresses, name, features, wanted.given, following))

    @router.get("/collections/{name}/items/{feature_id}", response_class=Features, responses=FEATURES)
    async def item(name: Name, feature_id: FeatureId, one: AskedDep) -> Features:
        """One feature by its id."""
        refuse_unknown(one.request)
        found, version = collection_of(name), await one.version()
        feature = await one.service.in_thread(lambda: found.one(one.service, version, feature_id))
        if feature is None:
            raise ProtocolError(404, "not-found", f"collection {name!r} has no feature {feature_id[:80]!r}")
        return Features(documents.item_document(one.addresses, name, feature))

    return router


router = APIRouter()
router.include_router(_router(of_map, "/v1/maps/{map_id}/ogc"))
router.include_router(_router(of_version, "/v1/maps/{map_id}/versions/{number}/ogc"))
