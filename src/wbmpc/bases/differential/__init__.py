"""Two driven wheels (or more on the same axle) and casters."""
