"""Geo-referencing of drives: geodesy and GNSS alignment; the only import of pyproj."""
