"""The evidence of sets of effects: one criterion for selection, naming, ambiguity and verdict."""
