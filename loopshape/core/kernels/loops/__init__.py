"""Kernels over open loops: margins, encirclements, rows of a tuning, the small linear programme."""
