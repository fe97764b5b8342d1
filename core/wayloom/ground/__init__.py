"""Ground layer: height surface, orthophoto and semantic ground of a drive in sheets, their fusion over drives, markings, kerbs."""
