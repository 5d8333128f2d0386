"""The search for the effects that explain a comparison.

In: a `Comparison`. Out: `Fitted` explanations, the best first, and what an explanation leaves over.
Effects say in their recipes how to search for them: `bank` and `scanners` give the starting points.
"""
