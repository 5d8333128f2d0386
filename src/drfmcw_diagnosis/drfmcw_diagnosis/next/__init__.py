"""Which further measurement would separate the explanations that fit alike.

In: an explanation and its rivals. Out: hypothetical measurements, ranked by how far
apart the explanations predict their results.
"""
