"""Ramps that one strong line shows.

In: sweeps of a station that hears itself. Out: the window in which its ramp is straight, the rate over frequency, the
delays of its lines; for several recordings of one radar the shape that they share.
"""
