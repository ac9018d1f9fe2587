"""What base types share whose wheels are fixed to the body: wheel rates are a constant matrix times the body's twist."""
