"""What a new controller will do, and how a later measurement compares with it."""
