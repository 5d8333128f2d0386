"""Effects with parameters that fit: templates, how far each number counts, and the fit itself.

In: a `Comparison`, effects with values where their fit begins. Out: `Fitted` explanations.
"""
