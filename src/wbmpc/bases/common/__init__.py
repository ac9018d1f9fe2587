"""What base types of this package share; no base type itself."""
