"""The oracles, which see the real arm."""
