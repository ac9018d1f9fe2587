"""Controllers for a robot's own program: one object file with a C header, without Python."""
