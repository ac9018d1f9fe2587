"""Experiments of Pankert et al., RA-L 2022: a reconfigurable swerve base with an arm."""
