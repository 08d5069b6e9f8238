"""Verdicts against those that were kept: what got worse, by how much, and whose part it is."""
