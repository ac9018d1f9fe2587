"""Runs in a browser: live, in a process of their own, and recordings. Needs the extra ``viz`` (viser)."""
