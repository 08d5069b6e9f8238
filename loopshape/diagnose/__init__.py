"""Two runs, or a run and a plant, to what parts them."""
