"""Nouns to pictures; matplotlib lives here only.

Every picture is `(noun, *, ax=None) -> Axes`, every page `(nouns) -> Figure`; figures are built without
pyplot, so no display and no global state. `style.save` writes them.
"""
