"""Whether a range may be trusted.

In: one sweep's results of both stations, their settings and calibrations, the sweeps before it.
Out: valid, doubtful or refused, which tests failed, a larger standard deviation, and a protection level.
"""
