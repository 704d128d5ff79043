"""From observations to a calibrated cell: one forward model, its derivatives, the estimators, what they could see."""
