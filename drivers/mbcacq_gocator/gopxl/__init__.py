"""LMI sensors that run GoPxL, the firmware after classic Gocator firmware: other ports, other messages, the same light."""
