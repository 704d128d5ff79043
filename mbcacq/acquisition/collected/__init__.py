"""Clouds that a scanner's own program has saved, brought together with the poses of a plan at which they were taken."""
