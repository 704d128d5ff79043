"""Make a controller ready for RSI over EKI: is it the right robot, are its drives on, does its RSI program run?"""

from __future__ import annotations

from mbcacq.devices import DeviceFault, IdentityError, same_model
from mbcacq_kuka.eki.client import EkiClient

_PORT = 54600
_LONGEST_ANSWER_S = 4.0


def start_by_eki(name: str, model: str, server: str, cycle_ms: int, wait_s: float) -> EkiClient:
    """The connected client; keep it open as long as RSI runs. server: 'host' or 'host:port'. wait_s: longest wait for one answer; never
    more than 4 s. Raises IdentityError, DeviceFault and what EkiClient raises.

    KUKA's server begins every connection without a control mode and with a cycle of 12 ms, and takes no START before a mode was chosen.
    """
    host, _, port = server.partition(":")
    client = EkiClient(host, int(port or _PORT), min(wait_s, _LONGEST_ANSWER_S))
    try:
        identity = client.connect()
        if model and not same_model(model, identity.model):
            raise IdentityError(f"robot '{name}': the controller at {server} drives a '{identity.model}', the plan is for '{model}'")
        status = client.poll()
        if status is not None and status.emergency_stop:
            raise DeviceFault(f"robot '{name}': the emergency stop is pressed; release and acknowledge it")
        client.drives_on()
        client.choose_cycle(cycle_ms)
        client.choose_joint_position()
        client.start()
    except BaseException:
        client.close()
        raise
    return client
