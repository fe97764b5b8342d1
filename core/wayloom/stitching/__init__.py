"""Fusion of submaps from all drives into one voxel map."""
