"""Studies that simulate: the policies to use on an arm, and a fresh draw of a board."""
