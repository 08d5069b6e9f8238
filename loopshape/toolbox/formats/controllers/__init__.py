"""Controllers and excitations out to targets, and parameters of drives and firmware in."""
