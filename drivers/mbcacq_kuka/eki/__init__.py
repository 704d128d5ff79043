"""KUKA.Ethernet KRL (EKI): start and watch the controller's programs over TCP."""

from mbcacq_kuka.eki.client import EkiClient, EkiStatus, RobotIdentity

__all__ = ["EkiClient", "EkiStatus", "RobotIdentity"]
