"""Cells with physics that no effect of the catalogue describes."""
