"""Geoid grids: orthometric heights, above the sea, from ellipsoidal ones: H = h - N."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from pyproj.exceptions import ProjError

from wayloom.errors import InputError

FloatArray = NDArray[np.float64]
REMEDY = "give a grid that PROJ reads, .gtx or GeoTIFF, as `projsync --source-id us_nga --file egm96` or cdn.proj.org brings it"


class GeoidGrid:
    """A vertical grid shift of PROJ. The file is read once; nothing is fetched."""

    def __init__(self, file: Path) -> None:
        """Raises InputError where the file is missing or is no grid."""
        if not file.is_file():
            raise InputError("no such geoid grid", file=file, remedy=REMEDY)
        if any(letter in str(file.absolute()) for letter in ',"'):
            raise InputError(
                "PROJ takes no path with a comma or a quotation mark", file=file, remedy="rename the file or its folder"
            )
        self.file = file
        shift = f'+proj=vgridshift +grids="{file.absolute()}" +multiplier=-1'
        turn = "+proj=unitconvert +xy_in=deg +xy_out=rad"
        try:
            self._shift = Transformer.from_pipeline(f"+proj=pipeline +step {turn} +step {shift} +step +inv {turn}")
        except ProjError as error:
            raise InputError(f"is no geoid grid ({error})", file=file, remedy=REMEDY) from None

    def orthometric(self, lon_lat_height: FloatArray) -> FloatArray:
        """(N,) m: heights above the geoid of places (N, 3) with ellipsoidal heights. Raises InputError beyond the grid."""
        points = np.asarray(lon_lat_height, np.float64).reshape(-1, 3)
        height = np.asarray(self._shift.transform(points[:, 0], points[:, 1], points[:, 2])[2], np.float64)
        outside = ~np.isfinite(height)
        if outside.any():
            lon, lat = points[int(np.argmax(outside)), :2].tolist()
            raise InputError(f"does not cover longitude {lon:.5f}, latitude {lat:.5f}", file=self.file, remedy=REMEDY)
        return height
