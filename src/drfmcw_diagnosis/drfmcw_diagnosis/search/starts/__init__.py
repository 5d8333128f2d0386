"""Where an effect's fit may begin: a bank of starting points, and scanners for positions too many to simulate.

In: the registry, the conditions of a recording, what an explanation leaves. Out: candidates with values of parameters.
"""
