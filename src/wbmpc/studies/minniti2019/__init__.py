"""Experiments of Minniti et al., RA-L 2019: a ball-balancing robot with an arm."""
