"""Experiments of two papers, one file each. Nothing outside of this package names it: the entry points in pyproject.toml do."""
