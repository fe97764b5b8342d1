"""Parts of a long drive: overlapping stretches tracked each on its own, and joined into one result."""
