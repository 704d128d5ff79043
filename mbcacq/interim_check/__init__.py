"""Interim checks of a calibrated cell: a few poses repeated, and whether, what, where and since when anything changed."""
