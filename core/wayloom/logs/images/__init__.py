"""Image decoding: formats, colour and grey, the PNG decoder of the odometry."""
