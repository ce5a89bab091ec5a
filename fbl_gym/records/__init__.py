"""Records with declared fields, checks of single values, and their documentation."""
