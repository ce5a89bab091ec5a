"""What is measured, and the evidence: rollouts, metrics, suites, the leaderboard and the command line."""
