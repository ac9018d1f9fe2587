"""A base that takes speeds, whatever is under it: skid steering, tracks, the driver of somebody else."""
