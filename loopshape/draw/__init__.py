"""Nouns to pictures; matplotlib lives here only."""
