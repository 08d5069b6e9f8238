"""Commands that only the arm has."""
