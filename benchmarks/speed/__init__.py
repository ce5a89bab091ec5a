"""Speed: steps per second beside other environments."""
