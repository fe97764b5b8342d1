"""The commands. They parse, make one call and return."""
