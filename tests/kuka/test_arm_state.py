"""A reader in another process never sees half of one state and half of the next."""

import subprocess
import sys

from mbcacq_fakes.protocols.krc.arm_state import FAULTS, ArmState

WRITER = """
import sys
from mbcacq_fakes.protocols.krc.arm_state import ArmState
with ArmState.attach(sys.argv[1]) as state:
    for i in range(20000):
        v = float(i)
        state.write(v, (v,) * 6, (v,) * 6, (v,) * 6, i % 2 == 0, i, i % 6)
"""


def test_values_come_back():
    with ArmState.create((0.1, 0.2, 0.3, 0.4, 0.5, 0.6)) as state, ArmState.attach(state.name) as other:
        assert other.read().standstill
        state.write(1.5, (1, 2, 3, 4, 5, 6), (0.1,) * 6, (1, -1, 0, 1, -1, 0), False, 7, 3)
        seen = other.read()
    assert (seen.time_s, seen.q, seen.direction) == (1.5, (1, 2, 3, 4, 5, 6), (1, -1, 0, 1, -1, 0))
    assert (seen.standstill, seen.arrivals, seen.fault) == (False, 7, FAULTS[3])


def test_another_process_reads_whole_states_and_leaves_the_block():
    with ArmState.create() as state:
        writer = subprocess.Popen([sys.executable, "-c", WRITER, state.name], stderr=subprocess.PIPE)
        while (seen := state.read()).time_s < 19999.0 and writer.poll() is None:
            v = seen.time_s
            assert seen.q == seen.qd == (v,) * 6
            assert seen.arrivals == int(v)
            assert seen.fault == FAULTS[int(v) % 6]
        assert writer.communicate()[1] == b""
        with ArmState.attach(state.name) as again:
            assert again.read().time_s == 19999.0
