"""One control step: torque, events, readings, reference, and the episode, in order."""
