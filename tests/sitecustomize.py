"""Imported by every Python whose PYTHONPATH names this folder: there a PNG that cannot be read is an error."""

from text_layout import look_at_each_png


def refuse(found: list[str]) -> None:
    raise AssertionError("\n".join(found))


look_at_each_png(refuse, note=True)
