"""What the nominal arm leaves out, and how it is followed along a recording."""
