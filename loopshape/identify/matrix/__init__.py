"""Several inputs and outputs: the matrix FRF, equivalent plants, interaction and its intervals."""
