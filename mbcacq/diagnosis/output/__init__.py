"""What a diagnosis reports: tables of effects, response curves, text, the next measurements."""
