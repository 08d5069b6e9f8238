"""Several loops of one plant at once: determinant, loci, structured margins."""
