"""Policies: find one by the text that names it, load it, and check what it promises."""
