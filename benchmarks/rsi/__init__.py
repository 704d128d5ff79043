"""Parts of ``rsi.py``: how soon a telegram is answered, and what a controller is given."""
