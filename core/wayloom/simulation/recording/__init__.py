"""Recording of drives: presets, worlds, journal, truth files, datasets."""
