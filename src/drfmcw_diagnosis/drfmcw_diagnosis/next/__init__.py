"""Which further measurement would separate the explanations that fit alike.

In: an explanation and its rivals. Out: hypothetical measurements, ranked by the
separation of the results that the explanations predict.
"""
