"""Calibration results in the formats of other programs, and certificates of artefacts out of theirs. One small file a format."""
