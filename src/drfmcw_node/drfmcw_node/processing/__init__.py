"""Which estimator evaluates which sweep: settings and calibrations looked up by stamp.

In: `Sweep`, settings and calibrations in any order. Out: `Beat` and `Spectrum`; nothing here knows ROS.
"""
