"""Omni and mecanum wheels, any number of them."""
