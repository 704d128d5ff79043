"""The rerun recording of a run: written, read back, drawn."""
