"""Several inputs and outputs: the matrix FRF, and equivalent plants."""
