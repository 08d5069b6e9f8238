"""What a controller will make of measured plants before it runs: S, T and the step, as nouns, file and picture."""
