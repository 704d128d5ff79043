"""A part of ``effects_loop.py``: what is learnt, tried at other places."""
