"""The servers of the fake devices, one folder a family of protocols."""
