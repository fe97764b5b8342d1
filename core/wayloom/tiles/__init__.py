"""Map tiles: grid, levels of detail, one encoder a format in TILE_FORMATS, and exports."""
