"""A base that does not move."""
