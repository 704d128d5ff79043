"""KRL, as much of it as the programs for the controller use: translated to Python and run against a fake controller."""

from mbcacq_fakes.protocols.krc.krl.interpreter import Interpreter
from mbcacq_fakes.protocols.krc.krl.program import Program
from mbcacq_fakes.protocols.krc.krl.values import KrlError, Struct

__all__ = ["Interpreter", "KrlError", "Program", "Struct"]
