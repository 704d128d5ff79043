"""RSI over a network that loses one datagram in a hundred: every cycle is accounted for, and the path is the same as without loss."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import HOME_DEG, LIMITS_DEG, free_port
from lossy import namespaces, relay, why_no_netem
from mbcacq_fakes.protocols.krc import FakeKrc

FAR = 30.0


def drive(network, counting, realtime=True):
    """What the controller logged and what the driver recorded of the same move."""
    with network as (controller, client, prefix):
        with FakeKrc(
            client=controller,
            bind="0.0.0.0" if prefix else "127.0.0.1",
            realtime=realtime,
            start_deg=tuple(HOME_DEG),
            limits_deg=LIMITS_DEG,
            timeout=100_000,
            counting=counting,
            log=True,
        ) as krc:
            program = [sys.executable, str(Path(__file__).with_name("rsi_client.py")), client[0], str(client[1]), str(FAR), "99999"]
            done = subprocess.run([*prefix, *program], capture_output=True, text=True, timeout=100)
            assert done.returncode == 0, done.stderr
            return krc.log(), {k: np.array(v) for k, v in json.loads(done.stdout).items()}


def commanded(log):
    """A1 of the corrections that the controller used, one a cycle, while they changed: (k,) deg."""
    used = log["correction"][log["accepted"], 0]
    return used[np.flatnonzero(used)[0] - 1 : np.flatnonzero(used < used.max())[-1] + 2]


@pytest.fixture(scope="module")
def undisturbed():
    from contextlib import nullcontext

    here = ("127.0.0.1", free_port())
    return commanded(drive(nullcontext((here, here, [])), "total", realtime=False)[0])


def check(log, recorded, undisturbed):
    np.testing.assert_array_equal(commanded(log), undisturbed)  # no step left out, none made twice, none larger
    first, last = recorded["ipoc"][0], recorded["ipoc"][-1]
    span = (log["ipoc"] >= first) & (log["ipoc"] <= last)
    asked = np.isin(log["ipoc"], recorded["ipoc"])
    assert not (log["accepted"] & ~asked)[span].any()  # nothing was used that was never asked for
    never_heard = np.count_nonzero(span & ~asked)
    assert never_heard == round((last - first) / 4) + 1 - len(recorded["ipoc"])
    return never_heard, np.count_nonzero(span & ~log["accepted"])


@pytest.mark.parametrize("counting", ["total", "consecutive"])
def test_one_percent_loss_through_a_relay(undisturbed, counting):
    log, recorded = drive(relay(), counting)
    never_heard, missed = check(log, recorded, undisturbed)
    assert 0 < never_heard < missed
    if counting == "total":  # the controller's own count, as the driver recorded it, is the number of cycles without a valid answer
        before = log["ipoc"] < recorded["ipoc"][-1]
        active = np.cumsum(log["accepted"]) > 0
        assert recorded["delay"][-1] == np.count_nonzero(before & active & ~log["accepted"])


@pytest.mark.parametrize("counting", ["total", "consecutive"])
def test_one_percent_loss_by_netem_between_namespaces(undisturbed, counting):
    if reason := why_no_netem():
        pytest.skip(reason)
    log, recorded = drive(namespaces(), counting)
    check(log, recorded, undisturbed)
