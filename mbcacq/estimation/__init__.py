"""The estimation engine: forward model, linearisation, whitening, variance components, solver, outliers, identifiability."""
