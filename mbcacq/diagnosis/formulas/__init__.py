"""Short formulas for an unmodelled effect that was located: a dictionary of terms, a search by evidence, scores on data left out."""
