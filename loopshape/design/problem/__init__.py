"""A tuning problem: a structure with free parameters, measured plants, and rows of room with their slopes."""
