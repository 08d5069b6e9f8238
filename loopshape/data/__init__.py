"""The nouns: frozen dataclasses with read-only arrays; each docstring gives shapes and units."""
