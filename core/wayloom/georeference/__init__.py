"""A drive into a geo-referenced frame: GNSS alignment, with honest covariance."""
