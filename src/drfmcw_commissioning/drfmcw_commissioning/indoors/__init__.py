"""Calibrating one station by itself, on the bench.

In: readings of a frequency counter, recordings with the antennas terminated or through a cable. Out: values with
their standard deviations, as sections of a calibration document.
"""
