"""Analysis of stored results: statistics, the board, orders in two worlds."""
