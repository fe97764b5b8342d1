"""Drive reports and map pictures for people: HTML, SVG and raster images."""
