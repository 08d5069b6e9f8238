"""Commands under "Verify"."""
