"""Recordings, findings and calibrations on disk, and the commands that work on recordings.

In: names from the page, checked against what is in the directory.
Out: lists, sizes, archives; processes that record, recompute and diagnose.
"""
