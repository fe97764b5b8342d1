"""Dense stereo depth of keyframes, and looks: what is kept of it when the images are gone."""
