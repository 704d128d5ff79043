"""The search for named effects: candidate scoring, beam search over sets of effects, selection criteria."""
