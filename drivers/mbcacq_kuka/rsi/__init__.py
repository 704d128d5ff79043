"""KUKA.RobotSensorInterface: joint corrections every 4 ms over UDP."""
