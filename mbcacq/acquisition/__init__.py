"""Executing a plan: the only place that moves a robot. It emits events and writes no file."""
