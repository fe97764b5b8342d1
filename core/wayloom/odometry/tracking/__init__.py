"""Frame-to-keyframe tracking: image pyramids, direct alignment, recovery, relocalisation, keyframe decision."""
