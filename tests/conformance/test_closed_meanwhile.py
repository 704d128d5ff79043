"""A connection that its far end closes while nobody uses it, as many devices do after seconds or an hour, is opened again before it is."""

from __future__ import annotations

import pytest
from benches import BENCHES, marked

OPENED_AGAIN = {  # with options: on a busy computer it takes longer to find a robot again
    "gocator": {},
    "gocator trigger": {},
    "gopxl": {},
    "kuka_eki": {"reconnect_s": 60.0},
    "modbus positioner": {},
    "modbus sensor": {},
    "opcua": {"silence_s": 60.0},
    "serial sensor": {},
}


@pytest.mark.parametrize(("name", "options"), [marked(name, options) for name, options in OPENED_AGAIN.items()])
def test_a_connection_that_was_closed_meanwhile_is_opened_again_before_it_is_used(name, options):
    with BENCHES[name].open() as stand, stand.make(**options) as driver:
        for _ in range(2):
            stand.use(driver)
            opened = {link: proxy.connections for link, proxy in stand.proxies.items()}
            for proxy in stand.proxies.values():
                proxy.cut()
            stand.use(driver)
            assert all(proxy.connections > opened[link] for link, proxy in stand.proxies.items())
