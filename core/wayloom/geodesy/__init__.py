"""Places on Earth: WGS84, tangent planes, map frames and UTM; the only import of pyproj."""
