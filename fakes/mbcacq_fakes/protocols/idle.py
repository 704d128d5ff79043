"""Pace in lock-step while the arm stands still: a scan, its evaluation and the recording then need the processor."""

_IDLE = ((1.0, 0.004), (0.35, 0.002))  # after standing still for so long (robot s), sleep for so long a cycle (s)


def idle_s(still_s: float) -> float:
    """Seconds to sleep before the next cycle of an arm that stands still since ``still_s`` of its own clock."""
    return next((sleep_s for longer_than, sleep_s in _IDLE if still_s > longer_than), 0.0)
