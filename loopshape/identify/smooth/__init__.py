"""FRF to the same FRF with what its lines have in common: smoothing, merging, resonances."""
