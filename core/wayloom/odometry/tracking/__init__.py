"""Frame-to-keyframe alignment: image pyramids, direct alignment, recovery, relocalisation, keyframe decision."""
