"""Whether a range is ever silently wrong.

In: a fault, its size, a distance, an estimator. The simulator and the nodes' own classes make ranges of it.
Out: how many ranges were valid, and how many of these were wrong, with the confidence bound of that rate.
"""
