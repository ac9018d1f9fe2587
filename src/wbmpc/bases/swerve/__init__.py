"""Steered and driven wheels, on fixed legs or on hinged legs with brakes."""
