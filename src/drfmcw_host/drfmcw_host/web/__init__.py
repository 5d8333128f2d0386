"""The pages.

In: the state, the phrases, a session.
Out: HTML by NiceGUI, and one stream of changed values per view, encoded once for all browsers that show it.
"""
