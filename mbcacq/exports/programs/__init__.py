"""Robot programs of others: the absolute joint targets in them, found by the grammar of each language, and written anew."""

from mbcacq.exports.programs.program import ProgrammedPoint, RobotProgram
from mbcacq.exports.programs.read import LANGUAGES, read_program

__all__ = ["LANGUAGES", "RobotProgram", "ProgrammedPoint", "read_program"]
