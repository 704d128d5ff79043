"""Scans of a part: placed by the calibrated cell, compared where they overlap, merged into one cloud, compared with a CAD model."""
