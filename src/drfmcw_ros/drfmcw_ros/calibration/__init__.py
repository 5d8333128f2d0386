"""Calibrations as documents that a station keeps.

In: a document (YAML), a station's state directory, a request to store one. Out: the `Calibration` that holds, the
document under its next version, or the reason why it is refused.
"""
