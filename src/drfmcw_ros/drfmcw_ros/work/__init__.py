"""Work that takes long: in worker processes, on a Dask cluster, under a progress bar.

In: functions and the items that they are to work on.
Out: results as they come, or why the work failed.
"""
