"""The proof on recordings of real radars.

In: directories of recordings, whose truth nobody knows. Out: a page that says what was found in each, what was learnt
from several of one radar, and whether effects that were added to real samples at a known size come out.
"""
