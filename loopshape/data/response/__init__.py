"""What is estimated: FRFs with their uncertainty, fits, dependence on level."""
