"""What is said of a recording, from the effects that the search found.

In: a `Search` and what it came to. Out: a `Judgement`: the verdict, the explanation, its rivals, and what is left.
"""
