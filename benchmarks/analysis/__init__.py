"""Analysis of stored results: statistics, the board, robustness and generalization."""
