"""Tables of others into columns: text, stamps, maps, and the door that chooses a reader."""
