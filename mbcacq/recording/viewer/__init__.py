"""The rerun viewer, opened on a recording."""
