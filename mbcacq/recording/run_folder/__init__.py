"""The folder of a run: journal, progress, the plan it was made with, recovery after a crash."""
