"""Commissioning simulated stations again and again.

In: how often, and the stations' true state. Out: errors of the ranges after each commissioning, beside the uncertainty
that the calibrations stated.
"""
