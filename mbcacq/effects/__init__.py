"""Physical effects of a cell, one file each; see docs/effects.md for how to add one."""
