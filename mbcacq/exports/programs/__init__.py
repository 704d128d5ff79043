"""Robot programs of others: the absolute joint targets in them, found by the grammar of each language, and written anew."""

from mbcacq.exports.programs.program import ProgrammedPoint as ProgrammedPoint
from mbcacq.exports.programs.program import RobotProgram as RobotProgram
from mbcacq.exports.programs.read import LANGUAGES as LANGUAGES
from mbcacq.exports.programs.read import read_program as read_program
