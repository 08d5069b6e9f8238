"""How the arm moves: right-hand sides, valves, equilibria, linearisations, the loop over ticks."""
