"""QGIS project of a map's features: a GeoPackage, a project that shows it in the classes' colours, and a style file a layer.

The XML has what QGIS 3 writes for a layer of each kind, and no more; what is left out has QGIS's usual value.
"""

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree.ElementTree import Element, SubElement, tostring

from wayloom.config.classes import CLASS_NAMES, PALETTE
from wayloom.config.progress import Progress, silent
from wayloom.exports.features import COLLECTIONS
from wayloom.exports.geopackage import write_geopackage
from wayloom.exports.source import MapSource
from wayloom.files.atomic import write_atomically
from wayloom.geodesy.antimeridian import Box

QGIS_VERSION: Final = "3.34.0"
EPSG: Final = 4326
ORDER: Final = ("objects", "tracks", "kerbs", "markings", "areas")
"""From the top of the map."""
KIND_CLASSES: Final = {"traffic_sign": "traffic sign", "traffic_light": "traffic light", "trunk": "vegetation"}
"""Of kinds whose name is not that of their class."""
PLAIN: Final = {"tracks": "#1264a3", "kerbs": "#ffd23f", "markings": "#1fd1ff"}
SYMBOLS: Final = {"Point": ("marker", "SimpleMarker"), "LineString": ("line", "SimpleLine"), "Polygon": ("fill", "SimpleFill")}


def write_qgis(
    path: Path, source: MapSource, box: Box | None, names: Sequence[str], provenance: Mapping[str, Any], progress: Progress = silent
) -> dict[str, int]:
    """Write NAME.gpkg, a style NAME.LAYER.qml for each layer, then the project NAME.qgs or .qgz; how many features each has."""
    data = path.with_suffix(".gpkg")
    counts = write_geopackage(data, source, box, names, provenance, progress)
    shown = [name for name in ORDER if counts.get(name)]
    for name in shown:
        style = Element("qgis", version=QGIS_VERSION, styleCategories="Symbology")
        style.append(renderer(name))
        write_atomically(path.with_suffix(f".{name}.qml"), _document(style))
    project = _document(_project(path.stem, data.name, shown, provenance))
    if path.suffix == ".qgz":
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(f"{path.stem}.qgs", project)
        project = packed.getvalue()
    write_atomically(path, project)
    return counts


def _document(root: Element) -> bytes:
    return b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n" + bytes(tostring(root, encoding="utf-8"))


def renderer(name: str) -> Element:
    """How a layer is drawn: one symbol for each kind in its class's colour, or one for all."""
    geometry = geometry_of(name)
    kinds = _kinds(name)
    if not kinds:
        found = Element("renderer-v2", type="singleSymbol", symbollevels="0", enableorderby="0")
        SubElement(found, "symbols").append(_symbol("0", geometry, PLAIN[name]))
        return found
    found = Element("renderer-v2", type="categorizedSymbol", attr="kind", symbollevels="0", enableorderby="0")
    categories, symbols = SubElement(found, "categories"), SubElement(found, "symbols")
    for number, (kind, colour) in enumerate(kinds.items()):
        SubElement(
            categories, "category", value=kind, symbol=str(number), label=kind.replace("_", " "), render="true", type="string"
        )
        symbols.append(_symbol(str(number), geometry, colour))
    return found


def geometry_of(name: str) -> str:
    """Of a layer's symbols; markings of several types are drawn as lines."""
    geometry = COLLECTIONS[name].geometry
    return "LineString" if geometry == "Geometry" else geometry


def _kinds(name: str) -> dict[str, str]:
    """Kinds of a layer and their colours."""
    kinds = {"objects": ("pole", "traffic_sign", "traffic_light", "trunk"), "areas": ("road", "sidewalk", "terrain")}.get(name, ())
    return {kind: "#" + PALETTE[CLASS_NAMES.index(KIND_CLASSES.get(kind, kind))].tobytes().hex() for kind in kinds}


def _symbol(name: str, geometry: str, colour: str) -> Element:
    kind, layer_class = SYMBOLS[geometry]
    red, green, blue = (int(colour[at : at + 2], 16) for at in (1, 3, 5))
    rgba = f"{red},{green},{blue},255"
    symbol = Element("symbol", type=kind, name=name, alpha="0.5" if geometry == "Polygon" else "1", clip_to_extent="1")
    layer = SubElement(symbol, "layer", {"class": layer_class, "enabled": "1", "pass": "0", "locked": "0"})
    options: dict[str, dict[str, str]] = {
        "Point": {"color": rgba, "name": "circle", "size": "2.4", "size_unit": "MM", "outline_color": "255,255,255,255"},
        "LineString": {"line_color": rgba, "line_width": "0.5", "line_width_unit": "MM"},
        "Polygon": {"color": rgba, "style": "solid", "outline_style": "no"},
    }
    about = SubElement(layer, "Option", type="Map")
    for option, value in options[geometry].items():
        SubElement(about, "Option", name=option, value=value, type="QString")
    return symbol


def _project(title: str, data: str, shown: Sequence[str], provenance: Mapping[str, Any]) -> Element:
    root = Element("qgis", version=QGIS_VERSION, projectname=title)
    SubElement(root, "title").text = title
    _reference_system(SubElement(root, "projectCrs"))
    tree, layers = SubElement(root, "layer-tree-group"), SubElement(root, "projectlayers")
    for name in shown:
        source = f"./{data}|layername={name}"
        SubElement(
            tree, "layer-tree-layer", id=name, name=name, source=source, providerKey="ogr", checked="Qt::Checked", expanded="1"
        )
        layers.append(_layer(name, source))
    SubElement(SubElement(root, "projectMetadata"), "abstract").text = json.dumps(provenance)
    return root


def _layer(name: str, source: str) -> Element:
    words = {"Point": "Point", "LineString": "Line", "Polygon": "Polygon"}
    layer = Element("maplayer", type="vector", geometry=words[geometry_of(name)], hasScaleBasedVisibilityFlag="0")
    SubElement(layer, "id").text = name
    SubElement(layer, "datasource").text = source
    SubElement(layer, "layername").text = name
    _reference_system(SubElement(layer, "srs"))
    SubElement(layer, "provider", encoding="UTF-8").text = "ogr"
    layer.append(renderer(name))
    return layer


def _reference_system(parent: Element) -> None:
    system = SubElement(parent, "spatialrefsys", nativeFormat="Wkt")
    for tag, text in (("srid", str(EPSG)), ("authid", f"EPSG:{EPSG}"), ("description", "WGS 84"), ("geographicflag", "true")):
        SubElement(system, tag).text = text
