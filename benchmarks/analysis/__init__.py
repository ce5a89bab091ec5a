"""Analysis of stored results: statistics, the board, the choice of a policy; and margins."""
