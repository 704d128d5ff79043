"""Fake devices behind Modbus and serial lines."""
