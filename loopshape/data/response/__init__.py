"""What is estimated: FRFs with their uncertainty, fits, interaction, dependence on level."""
