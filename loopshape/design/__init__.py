"""FRFs and Requirements to Controller."""
