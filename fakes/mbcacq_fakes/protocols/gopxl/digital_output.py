"""Digital outputs of the fake sensor: one device with two ports, as the vendor's sample for configuring a sensor asks for them."""

from __future__ import annotations

from typing import Any

ROOT = "/controls/digitalOutput"
DEVICES = f"{ROOT}/devices"
DEVICE = f"{DEVICES}/device-0"
MEASUREMENT, SOFTWARE, SYSTEM_STATE = 1, 2, 7  # events that switch a port: the first, the one that a client triggers, the last


class DigitalOutput:
    """What can be read and changed below ``ROOT``; every method returns None for a path that there is not.

    pulses: (port, payload) of each trigger by a client.
    """

    def __init__(self, serial: str) -> None:
        self.enabled, self.added = False, False
        self.device = {"deviceId": f"sensor-{serial}", "displayName": "Sensor"}
        self.ports = {
            f"{DEVICE}/ports/port-{k}": {"triggerEvent": MEASUREMENT, "signalType": 0, "scheduled": False, "pulseWidth": 100}
            for k in (0, 1)
        }
        self.pulses: list[tuple[str, dict[str, Any]]] = []

    def read(self, path: str) -> dict[str, Any] | None:
        if path == ROOT:
            return {"enabled": self.enabled}
        if path == f"{ROOT}/availableDevices":
            return {"devices": [] if self.added else [dict(self.device)]}
        if path == DEVICES:
            links = {"_links": {"self": {"href": DEVICE}}}
            return {"_embedded": {"item": [{**links, **self.device}]}} if self.added else {}
        return {"parameters": dict(self.ports[path])} if self.added and path in self.ports else None

    def update(self, path: str, payload: dict[str, Any]) -> str | None:
        """'' if it is done, a sentence where a value cannot be."""
        if path == ROOT:
            self.enabled = bool(payload.get("enabled", self.enabled))
            return ""
        if not self.added or path not in self.ports:
            return None
        wanted = self.ports[path] | payload.get("parameters", {})
        if not MEASUREMENT <= wanted["triggerEvent"] <= SYSTEM_STATE:
            return f"triggerEvent is out of range {MEASUREMENT} to {SYSTEM_STATE}"
        self.ports[path] = wanted
        return ""

    def create(self, path: str, payload: dict[str, Any]) -> dict[str, Any] | None:
        if path != DEVICES or payload.get("deviceId") != self.device["deviceId"]:
            return None
        self.added = True
        return {"path": DEVICE}

    def call(self, path: str, payload: dict[str, Any]) -> str | None:
        """As ``update``."""
        port = path.removesuffix("/commands/trigger")
        if port == path or not self.added or port not in self.ports:
            return None
        if self.ports[port]["triggerEvent"] != SOFTWARE:
            return "the output is not switched by software"
        self.pulses.append((port, payload))
        return ""
