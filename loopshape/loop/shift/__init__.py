"""Loop to detuning margin: plants whose frequencies are shifted."""
