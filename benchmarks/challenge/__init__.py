"""Parts of ``challenge.py``: the score table, and formulas for what is outside the catalogue."""
