"""Files that every room writes: atomic replacement, text records, time stamps, trajectories, PLY."""
