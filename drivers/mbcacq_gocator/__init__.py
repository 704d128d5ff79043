"""LMI Gocator over its native TCP protocol: control 3190, health 3194, data 3196, discovery udp 3220."""
