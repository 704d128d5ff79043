"""A scanner's own program: triggered by a line over TCP, it saves a cloud into a folder."""

from mbcacq_fakes.protocols.folder.program import FAULTS as FAULTS
from mbcacq_fakes.protocols.folder.program import FakeScannerProgram as FakeScannerProgram
