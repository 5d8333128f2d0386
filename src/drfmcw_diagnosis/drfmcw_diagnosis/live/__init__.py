"""The diagnosis of a running graph.

In: topics of one pair of stations. Out: diagnostics that say whether the model still explains the data, and findings.
"""
