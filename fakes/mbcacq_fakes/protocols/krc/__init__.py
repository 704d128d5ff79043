"""Fake KUKA controllers: RSI over UDP, and EKI over TCP with the KRL programs of the controller, an arm behind each."""
