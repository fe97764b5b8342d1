"""One drive on one page: track, segment, label, geo-reference, submaps."""
