"""How the loops of one plant meet: coefficients, relative gains, verdicts by band; matrix and filters that decouple."""
