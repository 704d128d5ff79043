"""KUKA.Ethernet KRL (EKI): start and watch the controller's programs over TCP."""
