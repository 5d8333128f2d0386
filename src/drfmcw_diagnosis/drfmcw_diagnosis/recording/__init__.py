"""A recording as arrays.

In: the path of a recording. Out: `Dataset`, every sweep of one pair of stations with the conditions around it, and the
groups of sweeps that share conditions.
"""
