"""Scenes of a station that hears itself, sample by sample.

In: a dataset of such a station. Out: a `Diagnosis` of what receiver and ramp do that many lines, or one line whose ramp
is bent by per cents, show best in the samples; None where the comparison of features serves better.
"""
