"""What all stand on: errors, units, and compiled kernels on bare arrays."""
