"""Forward model of a scene: lines of a ramp, refined together over all sweeps, and a test against measured noise.

In: sweeps of a station that hears itself. Out: lines, what they leave of samples that were held out over what noise
leaves there, and the chance of that.
"""
