"""What the page says, in English and German.

In: values in SI units, flags, a language.
Out: text; every phrase stands once, in both languages, in `phrases`.
"""
