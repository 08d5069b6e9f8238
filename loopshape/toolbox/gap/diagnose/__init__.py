"""A run and a plant to what parts them: hypotheses, evidence, probabilities."""
