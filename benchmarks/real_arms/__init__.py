"""Parts of ``real_arms.py``: recordings of real arms, from outside."""
