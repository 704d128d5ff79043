"""A fake EKI controller ticked by hand, with a client of a few lines. Its programs and tag tables are the files that are shipped."""

import fcntl
import re
import select
import socket
import struct
import termios
import time
from importlib.resources import files

from mbcacq_fakes.protocols.krc.eki_process import EkiController
from mbcacq_fakes.protocols.krc.eki_settings import EkiSettings

FOLDER = files("mbcacq_kuka") / "controller"
HOME = (0.0, -90.0, 90.0, 0.0, 0.0, 0.0)
START_DEG = (0.0, -90.0, 90.0, 0.0, 1.0, 0.0)  # beside the singularity of the wrist
EKI_LIMITS_DEG = [(-5, 5), (-95, -85), (85, 95), (-5, 5), (-5, 5), (-5, 5)]  # as in the shipped data list
SPEED_DEG_S = (200.0, 175.0, 190.0, 430.0, 430.0, 630.0)
SYSTEMS = ("kss", "iiqka")
# KR 10 R1100-2: sign, theta_deg, d_mm, a_mm, alpha_deg, beta_deg
DH = (
    (-1, 0, 400, 25, -90, 0),
    (1, 0, 0, 560, 0, 0),
    (1, -90, 0, 25, -90, 0),
    (-1, 0, 515, 0, 90, 0),
    (1, 0, 0, 0, -90, 0),
    (-1, 180, 90, 0, 0, 0),
)


def text(name):
    return (FOLDER / name).read_text()


def sources(system="kss"):
    return {
        "mbcacq_eki.dat": text("eki_kss/mbcacq_eki.dat"),
        "mbcacq_eki.src": text("eki_kss/mbcacq_eki.src"),
        "mbcacq_link.src": text(f"eki_{system}/mbcacq_link.src"),
    }


def settings(system="kss", **more):
    return EkiSettings(**{"sources": sources(system), "channel": text(f"eki_{system}/mbcacq_eki.xml"), "start_deg": HOME, "dh": DH, **more})


class Bench:
    """The controller's arm stands still to the last digit, so that the bytes of a telegram can be stated."""

    def __init__(self, system="kss", **more):
        self.controller = EkiController(settings(system, **{"encoder_noise_deg": 0.0, "encoder_step_deg": 0.0, **more}))
        self.variables = self.controller.program.globals
        self.sockets = []
        self.ticks(6)

    def ticks(self, number):
        for _ in range(number):
            self.controller.tick()

    def dial(self):
        self.socket = socket.create_connection(("127.0.0.1", self.controller.channel.port), 5.0)
        self.sockets.append(self.socket)
        self.say(kind=0)
        return self.socket

    def say(self, kind=0, number=0, speed=20.0, accel=50, axes=HOME, ticks=6, extra=b""):
        """A command, by hand, as the controller's files describe it."""
        a = " ".join(f'A{i + 1}="{v}"' for i, v in enumerate(axes))
        self.send(
            f'<Command Kind="{kind}" Id="{number}" Beat="7" Speed="{speed}" Accel="{accel}"><Axis {a}></Axis></Command>'.encode() + extra
        )
        self.ticks(ticks)

    def send(self, data):
        """Returns when the controller's side of the network has it, or has closed the connection."""
        self.socket.setblocking(True)
        self.socket.sendall(data)
        deadline, closed = time.monotonic() + 5.0, select.poll()
        closed.register(self.socket, select.POLLRDHUP)
        while struct.unpack("i", fcntl.ioctl(self.socket, termios.TIOCOUTQ, bytes(4)))[0] and time.monotonic() < deadline:
            if closed.poll(0):
                return
            time.sleep(1e-4)

    def hear(self):
        """Everything the controller has said, as text."""
        self.socket.setblocking(False)
        data = b""
        try:
            while more := self.socket.recv(1 << 20):
                data += more
        except (BlockingIOError, ConnectionError):
            pass
        return data.decode()

    def last(self, name):
        """A number of the newest State."""
        self.hear()
        self.ticks(12)
        return float(re.findall(rf'<State [^>]*\b{name}="([^"]*)"', self.hear())[-1])

    def q(self):
        return list(self.controller.system.machine.arm.q)

    def until(self, condition, most=5000):
        for _ in range(most):
            if condition():
                return True
            self.say(kind=0, ticks=1) if not _ % 50 and self.controller.channel.client else self.ticks(1)
        return False

    def close(self):
        self.controller.channel.close()
        for each in self.sockets:
            each.close()
