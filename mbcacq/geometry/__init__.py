"""Rigid-body geometry: SE(3), the MD-H chain with its screws, gravity torque; arrays over poses, never loops over them."""
