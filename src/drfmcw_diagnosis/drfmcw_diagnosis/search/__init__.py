"""The search for the effects that explain a comparison.

In: a `Comparison`. Out: `Fitted` explanations, the rivals that fit as well, and what an explanation leaves over.
How each effect is searched for stands in `bank`.
"""
