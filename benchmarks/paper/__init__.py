"""Parts of ``paper.py``: the published experiment, and what may have left its constant error."""
