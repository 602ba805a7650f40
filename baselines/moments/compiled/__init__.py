"""The same moments as loops that numba compiles, with derivatives, for one Gaussian at a time."""
