"""Commands under "Design"."""
