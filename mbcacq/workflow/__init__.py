"""What the command line and programs call: run, evaluate, simulate."""
