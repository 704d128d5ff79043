"""KRL, as much of it as the programs for the controller use: translated to Python and run against a fake controller."""

from mbcacq_fakes.protocols.krc.krl.interpreter import Interpreter as Interpreter
from mbcacq_fakes.protocols.krc.krl.program import Program as Program
from mbcacq_fakes.protocols.krc.krl.values import KrlError as KrlError
from mbcacq_fakes.protocols.krc.krl.values import Struct as Struct
