"""A target over a wire: frames, messages, sessions, and one recording taken."""
