"""Robot files from what people have: URDF, xacro, MJCF, a table of Denavit-Hartenberg rows."""

from mbcacq.model.robot_import.import_robot import ImportedRobot as ImportedRobot
from mbcacq.model.robot_import.import_robot import import_robot as import_robot
