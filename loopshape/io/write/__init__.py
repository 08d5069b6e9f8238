"""Nouns in files of their own and back: FRFs, controllers, requirements, fits, predictions, verdicts."""
