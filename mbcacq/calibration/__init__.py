"""From observations to a calibrated cell, and how far to trust it."""
