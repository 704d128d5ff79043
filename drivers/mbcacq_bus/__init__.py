"""Positioners and sensors on simple buses: Modbus TCP and RTU, serial lines, and an operator who is asked to move the tripod."""
