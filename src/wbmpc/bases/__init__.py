"""Base types: the table of plug-ins."""
