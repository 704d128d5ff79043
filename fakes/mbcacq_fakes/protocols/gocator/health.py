"""The health channel of the fake sensor: one message a period."""

from __future__ import annotations

from mbcacq_fakes.protocols.gocator import encode
from mbcacq_fakes.protocols.gocator.state import SensorState


def publish_health(state: SensorState) -> None:
    """Publish until the sensor closes."""
    while not state.closing.wait(state.options.health_period_s):
        state.health.publish(health_messages(state))


def health_messages(state: SensorState) -> list[bytearray]:
    """What is sent now; nothing while the fault ``mute_health`` is active."""
    if state.faults.get("mute_health"):
        return []
    major, minor, release, build = state.firmware
    values = {
        (20000, 0): int(state.running),
        (2000, 0): major << 24 | minor << 16 | release << 8 | build,
        (2017, 0): int(state.uptime_s),
        (2002, 0): round(state.temperature_C),
        (2404, 0): round(state.temperature_C) + 4,
        (1003, 0): state.encoder,
        (20005, 0): state.exposures,
        (2007, 0): 12,
        **state.indicators,
    }
    return [encode.health(values)]
