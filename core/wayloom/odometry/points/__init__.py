"""Points of the map: candidate selection, static stereo, immature points, activation."""
