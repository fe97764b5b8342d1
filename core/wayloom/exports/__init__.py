"""Map exports: one writer a format in EXPORT_FORMATS, fed region by region from a map of any origin."""
