"""Areas of road, sidewalk and terrain as polygons on a raster of the ground."""
