"""From true states to samples.

In: stations and paths as they are in every sweep, effects, seeds.
Out: IF samples with noise and quantisation; curves that a recording taught.
"""
