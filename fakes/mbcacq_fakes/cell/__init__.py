"""The fake cell: its process, ports and faults, and the same cell computed without protocols."""
