"""Analysis of stored results: statistics, the board, robustness, generalization; and margins."""
