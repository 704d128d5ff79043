"""Challenges: effects concealed in the fake cell, recorded, diagnosed blind, then scored against what was concealed."""
