"""The controllers of the paper, and their parts."""
