"""Loop closure within a drive: candidates, verification, consistent sets."""
