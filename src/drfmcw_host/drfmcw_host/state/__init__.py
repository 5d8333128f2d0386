"""What the page shows, free of ROS.

In: readings of ranges, references, lines, spectra, settings and diagnostics, each with its time of arrival.
Out: the newest of each with its age, and decimated histories from 10 s to 24 h.
"""
