"""The views, one page each.

In: the state, a viewer's language and rights.
Out: a page's elements, and the values that its stream changes.
"""
