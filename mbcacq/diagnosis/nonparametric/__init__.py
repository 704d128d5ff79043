"""Mismatch without a parametric effect: basis functions at every location, evidence, random effects."""
