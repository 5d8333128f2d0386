"""What is measured on the samples of each sweep.

In: IF samples of one or two stations, measured or simulated. Out: `SweepFeatures`; nothing here knows a model.
"""
