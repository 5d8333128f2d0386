"""Arrays of a file into sweeps of a recording.

In: a `Source` and `ImportSettings`. Out: a recording of one station that hears itself (of two for a triangular ramp),
and `Finding`s, what was assumed about the samples and whether they agree.
"""
