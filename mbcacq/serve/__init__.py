"""Runs to look at in a browser, on this computer only: verdicts, reports, plans in 3D, and a run that goes on, with its stop."""
