"""A diagnosis as data, sentences, page and simulator configuration.

In: a comparison and its explanations. Out: `Diagnosis`, its JSON, its report and the refined scenario.
"""
