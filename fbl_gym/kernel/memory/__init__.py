"""The memory of a batch: its layout, a scenario packed into it, and views with named fields."""
