"""Challenges: effects injected in the fake cell, recorded, diagnosed without knowledge of them, then scored against what was injected."""
