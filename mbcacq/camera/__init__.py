"""Images of a planar target: its points found, the camera's intrinsics and the target's pose in each image."""
