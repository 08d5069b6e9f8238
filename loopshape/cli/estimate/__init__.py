"""Commands under "Estimate"."""
