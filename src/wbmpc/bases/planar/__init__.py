"""A base that takes speeds, of any drive: skid steering, tracks, a vendor's driver."""
