"""Place recognition: compact descriptors of where a drive has been, and their index."""
