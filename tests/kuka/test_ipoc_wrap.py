"""IPOC begins again while an arm moves, at 2^32 or with a sign at 2^31: the motion goes on as if nothing had happened. Simulated clock."""

import numpy as np
import pytest
from rsi_bench import SOURCE, START, Bench

FAR = (20.0, *START[1:])


class Counted(Bench):
    """Its telegrams show ``shown(ipoc)`` in place of the IPOC by which the bench counts."""

    shown = staticmethod(str)

    def telegram(self, ipoc=None):
        return super().telegram(self.shown(self.ipoc if ipoc is None else ipoc))

    def reply(self, data, source=SOURCE, in_time=True):
        answer = self.session.reply(data, source, self.ipoc * 1e-3, in_time)
        self.session.digest(self.ipoc * 1e-3)
        if answer is not None:
            assert data[data.index(b"<IPOC>") : data.index(b"</IPOC>")] in answer  # digit by digit, with its sign
        return answer


def unsigned(ipoc):
    return str((ipoc + 2**32 - 2000) % 2**32)


def signed(ipoc):
    return str((ipoc + 2**31 - 2000 + 2**31) % 2**32 - 2**31)


def through_zero(ipoc):
    return str(ipoc - 2000)


def driven(shown):
    """Corrections of A1 that a motion over the turn of the counter was made of."""
    one = type("One", (Counted,), {"shown": staticmethod(shown)})()
    try:
        one.move(FAR)
        for _ in range(400):
            assert one.cycle() is not None
        assert one.shared.fault() is None
        return np.array(one.sent)[:, 0]
    finally:
        one.shared.close()


@pytest.mark.parametrize("shown", [unsigned, signed, through_zero])
def test_a_motion_over_the_turn_of_the_counter_is_the_same_motion(shown):
    turned = driven(shown)
    assert turned[-1] == pytest.approx(20.0, abs=1e-6)
    np.testing.assert_array_equal(turned, driven(str))
