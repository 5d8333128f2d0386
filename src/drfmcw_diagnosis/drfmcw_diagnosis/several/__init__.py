"""Several recordings at once: what they share, and what each has alone.

In: paths of recordings. Out: a `Diagnosis` of each, and `Joint`: effects of the same hardware with their combined
sizes, and whether the recordings agree on them. `running` is the work, in processes or on a Dask cluster.
"""
