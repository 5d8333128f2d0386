"""Many trials at many points: spread over processes or a Dask cluster, stored batch by batch, resumable.

In: a `Study` (points, trials, batch size) and a task that makes the trials of a point. Out: a `ResultDirectory` with
one file per batch, the same to the last bit whoever did the work, in whatever order, interrupted or not.
"""
