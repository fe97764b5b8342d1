"""Results of a drive: the builder that gathers them, the filter of points, the file."""
