"""Arrays in, arrays out; compiled with numba, plain beneath."""
