"""A drive into a geo-referenced frame: geodesy, GNSS alignment; the only import of pyproj."""
