"""Studies that simulate: margins, a policy for an arm, where rows end, a fresh draw."""
