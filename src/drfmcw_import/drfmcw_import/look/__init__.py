"""Looking at a recording.

In: the path of a recording. Out: `StationSweeps`, what is measured on them, pictures, and one page that holds them all.
"""
