"""Calibrating a pair where it works.

In: a recording with reference distances. Out: what of the calibration these determine, with its covariance, and which
further measurement would determine the rest.
"""
