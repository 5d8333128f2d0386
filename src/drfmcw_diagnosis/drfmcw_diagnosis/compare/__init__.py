"""Measured features beside those that the simulator's forward model predicts.

In: a `Dataset`, and the effects to simulate. Out: `Comparison`, one vector of residuals over their standard deviations,
and `Comparison.template`, what effects add to that vector.
"""
