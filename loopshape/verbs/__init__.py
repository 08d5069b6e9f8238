"""The verbs of the public face: what a script or a command does with nouns, files and machines."""
