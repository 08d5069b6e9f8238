"""What is injected: a kind and its numbers come in, samples go out."""
