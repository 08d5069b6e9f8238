"""A first map for somebody's file: what it seems to hold, each guess with its reason."""
