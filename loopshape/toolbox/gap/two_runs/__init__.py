"""Two runs, without a model, to what parts them."""
