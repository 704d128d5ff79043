"""Parts of ``detection.py``: how often an effect is found, and what is said of those that are not."""
