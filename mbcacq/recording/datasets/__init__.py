"""Folders of YAML and CSV: observation sets and trajectory sets."""
