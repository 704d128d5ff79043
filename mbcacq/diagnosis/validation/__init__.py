"""Validation on held-out data: folds, predictive scores, worker processes."""
