"""Policies: find one by the text that names it, load it, and hash what it depends on."""
