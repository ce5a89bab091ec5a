"""Pictures of the arm, and the window of an environment; imported on demand."""
