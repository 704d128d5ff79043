"""The cell, its observations and its trajectories as plain arrays, and the YAML schema of a cell."""
