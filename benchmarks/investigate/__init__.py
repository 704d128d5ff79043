"""Parts of ``investigate.py``: cells that investigate themselves, their advice, and the order of a plan's poses."""
