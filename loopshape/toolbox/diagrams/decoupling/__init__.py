"""What stands between several controllers and one plant: a matrix or filters that decouple."""
