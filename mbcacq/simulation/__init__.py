"""A recording against somebody else's simulation: a set that another simulator made, or a model file that MuJoCo runs."""
