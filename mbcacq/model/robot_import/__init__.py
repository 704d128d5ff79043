"""Robot files from what people have: URDF, xacro, MJCF, a table of Denavit-Hartenberg rows."""

from mbcacq.model.robot_import.import_robot import ImportedRobot, import_robot

__all__ = ["ImportedRobot", "import_robot"]
