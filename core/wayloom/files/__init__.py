"""Writers and readers that every room uses: atomic replacement, text records, time stamps, trajectories, PLY clouds."""
