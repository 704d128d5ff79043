"""Adaptive design of experiments: a nested order for a plan, and the visit of a station that decides most of what is left open."""
