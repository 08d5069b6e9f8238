"""From an old controller to a new one on a running machine: what is predicted, watched, measured, and decided."""
