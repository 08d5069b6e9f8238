"""Tables of others as runs: a file and a map in, columns out."""
