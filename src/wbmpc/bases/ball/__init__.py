"""A base that balances on a ball."""
