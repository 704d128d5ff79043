"""Optimal experiment design: which poses to measure, what accuracy to expect, which effects would be detectable."""
