"""How a station estimates a beat frequency from the samples of a sweep. One estimator per file.

In: samples of sweeps (arrays), the sweep's settings, calibrations. Out: `Estimates`; nothing here knows ROS.
"""
