"""The command at a terminal, with somebody who types."""

import os
import pty
import select
import subprocess
import time

from typed_command import MBCACQ, ROOT


class Terminal:
    """The command with a terminal as standard input; what it asks goes to stderr."""

    def __init__(self, *arguments, cwd=ROOT):
        self._mine, theirs = pty.openpty()
        self.process = subprocess.Popen(
            [MBCACQ, *map(str, arguments)], cwd=cwd, stdin=theirs, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        os.close(theirs)
        self.text = ""

    def wait_for(self, words, times=1, within_s=900):
        deadline = time.monotonic() + within_s
        while self.text.count(words) < times:
            assert time.monotonic() < deadline, self.text
            if select.select([self.process.stderr], [], [], 0.2)[0]:
                data = os.read(self.process.stderr.fileno(), 65536)
                assert data, self.text
                self.text += data.decode()

    def type(self, line):
        os.write(self._mine, f"{line}\n".encode())

    def end(self):
        rest = self.process.communicate(timeout=900)[1]
        os.close(self._mine)
        self.text += rest.decode()
        return self.process.returncode
