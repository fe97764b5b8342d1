"""Column type of a geometry in WGS84: PostGIS's `geometry`, and well-known binary where the database has no such type."""

from typing import Any

from sqlalchemy import BindParameter, ColumnElement, Dialect, LargeBinary, func, type_coerce
from sqlalchemy.dialects.postgresql.base import ischema_names
from sqlalchemy.types import TypeEngine, UserDefinedType

WGS84 = 4326


class Geometry(UserDefinedType[bytes]):
    """PostGIS's type; Python gives and gets well-known binary."""

    cache_ok = True

    def __init__(self, kind: str = "Geometry", srid: int | str = WGS84) -> None:
        self.kind, self.srid = kind, int(srid)

    def get_col_spec(self, **_: Any) -> str:
        """As the database spells it."""
        return f"geometry({self.kind},{self.srid})"

    def bind_expression(self, bindparam: BindParameter[bytes]) -> ColumnElement[bytes]:
        """Bytes to a geometry."""
        return func.ST_GeomFromWKB(type_coerce(bindparam, LargeBinary()), self.srid, type_=self)

    def column_expression(self, column: ColumnElement[bytes]) -> ColumnElement[bytes]:
        """A geometry to bytes."""
        return func.ST_AsBinary(column, "NDR", type_=LargeBinary())

    def compare_against_backend(self, _dialect: Dialect, found: TypeEngine[Any]) -> bool:
        """Whether the database's column is of this very type."""
        return isinstance(found, Geometry) and (found.kind.lower(), found.srid) == (self.kind.lower(), self.srid)


def geometry(kind: str) -> TypeEngine[bytes]:
    """The type of a column of such geometries (`wkb.wkb_as`) on either database."""
    return Geometry(kind).with_variant(LargeBinary(), "sqlite")


ischema_names["geometry"] = Geometry  # so that the comparison of models and database knows it
