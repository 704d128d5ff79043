"""An RSI session without sockets, and an arm that follows its last answer at once."""

import math
import re

from mbcacq_kuka.rsi.options import RsiOptions
from mbcacq_kuka.rsi.session import RsiSession
from mbcacq_kuka.rsi.shared import MOVE, STOP, RsiCommand, Shared

START = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
LIMITS = ((-180.0, 180.0), (-150.0, 10.0), (-120.0, 160.0), (-350.0, 350.0), (-125.0, 125.0), (-350.0, 350.0))
SPEED, ACCELERATION, JERK, T = 100.0, 400.0, 4000.0, 0.004
SOURCE = ("127.0.0.1", 50007)


class Bench:
    """``cycle`` is one exchange; ``q``: where the arm is, deg, with a lag of ``lag_s``, and A1 by ``beside_deg`` beside its set point;
    ``sent``: corrections that the controller used; ``heard``: IPOC of the last telegram that was answered."""

    def __init__(self, lag_s=0.0, **options):
        self.lag_s, self.beside_deg = lag_s, 0.0
        self.shared, self.outputs = Shared.create(), options.get("digital_outputs", ())
        self.session = RsiSession(self.shared, RsiOptions(limits_deg=LIMITS, **options).settings())
        self.ipoc, self.delay, self.sent = 1000, 0, []
        self.q = START
        while not self.session.connected:
            self.cycle()
        for _ in range(2):
            self.cycle()

    def telegram(self, ipoc=None):
        """As of a controller that reports the outputs of the plan, all of them off."""
        outputs = " ".join(f'o{number}="0"' for number in self.outputs)
        digout = f"<Digout {outputs}/>" if outputs else ""
        axes = " ".join(f'A{i + 1}="{v:.6f}"' for i, v in enumerate(self.q))
        ipoc = self.ipoc if ipoc is None else ipoc
        return f'<Rob Type="KUKA"><AIPos {axes}/><Delay D="{self.delay}"/>{digout}<IPOC>{ipoc}</IPOC></Rob>'.encode()

    def cycle(self, data=None, source=SOURCE, step=4, accepted=True, counted=None):
        """The correction answered, or None; an answer without one asks for what the controller has. counted: whether the controller counts
        the answer as late, by default where it does not take it."""
        self.ipoc += step
        answer = self.reply(self.telegram() if data is None else data, source)
        if answer is None:
            return None
        correction = tuple(float(v) for v in re.findall(rb'A\d="([^"]+)"', answer)) or self.sent[-1]
        if accepted:
            self.sent.append(correction)
        share = 1.0 - math.exp(-T / self.lag_s) if self.lag_s else 1.0
        target = [s + c + b for s, c, b in zip(START, self.sent[-1], (self.beside_deg, 0, 0, 0, 0, 0), strict=True)]
        self.q = tuple(q + share * (t - q) for q, t in zip(self.q, target, strict=True))
        self.delay += not accepted if counted is None else counted
        return correction

    def reply(self, data, source=SOURCE, in_time=True):
        answer = self.session.reply(data, source, self.ipoc * 1e-3, in_time)
        self.session.digest(self.ipoc * 1e-3)
        if answer is not None:
            self.heard = int(re.search(rb"<IPOC>(\d+)<", data)[1])
        return answer

    def move(self, target):
        self.shared.send(RsiCommand(MOVE, target, (SPEED,) * 6, (ACCELERATION,) * 6, (JERK,) * 6, 0.01, 0.1))

    def stop(self):
        self.shared.send(RsiCommand(STOP))
