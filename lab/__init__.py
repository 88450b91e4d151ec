"""What makes the published tables. Not installed; run from a checkout by `python -m lab NAME`."""
