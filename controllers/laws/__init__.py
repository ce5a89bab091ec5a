"""The comparators."""
