"""What is asked of a loop: requirements, masks, weights, profiles of standards, objectives."""
