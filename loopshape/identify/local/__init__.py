"""Local models of a whole record over its lines, sweeps included."""
