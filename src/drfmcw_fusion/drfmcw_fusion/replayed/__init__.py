"""What a replay shows.

In: a recording's ranges, recomputed.
Out: statistics, table and plot; their comparison with the recorded ranges; velocity by up and down ramps.
"""
