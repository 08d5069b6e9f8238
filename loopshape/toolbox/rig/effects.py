"""The effects that a study asks for: looked up in a plant's catalogue, and turned into parameters.

An effect is asked for by NAME, or by NAME:FORM with the form's number in the catalogue, from 1, at a magnitude in the
catalogue's unit. Without a form the first one that can have the magnitude is taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from loopshape.core.errors import WrongUseError, refuse_unknown
from loopshape.toolbox.gap.nouns.effect import Effect, EffectForm


def catalogue(plant: Any) -> tuple[EffectForm, ...]:
    """All forms of a plant's effects; refuses a plant without any."""
    forms = tuple(getattr(plant, "effects", ()))
    if not forms:
        raise WrongUseError(
            f"the plant {plant.name} has no catalogue of effects", "an effect", "leave it out, or change [parameters]"
        )
    return forms


def forms_of(plant: Any, name: str) -> tuple[EffectForm, ...]:
    """The forms of one effect, in order; refuses an unknown one and lists the known."""
    forms = catalogue(plant)
    known = tuple(dict.fromkeys(form.effect for form in forms))
    refuse_unknown(f"{plant.name} has no such effect", name, known, "known are")
    return tuple(form for form in forms if form.effect == name)


def bounds(form: EffectForm) -> tuple[float, float]:
    """Least and largest magnitude of a form, in its unit."""
    first = form.free[0]
    low, high = sorted((first.low * form.scale, first.high * form.scale))
    return low, high


def middle(form: EffectForm) -> float:
    """Middle of a form's usual range, in its unit; where no narrower one is known than its bounds, its first start."""
    if tuple(form.usual) == bounds(form) or form.usual[1] == float("inf"):
        return form.scale * form.free[0].starts[0]
    return 0.5 * (form.usual[0] + form.usual[1])


def asked(plant: Any, words: Iterable[str]) -> dict[str, float]:
    """Magnitudes by NAME or NAME:FORM of words NAME, NAME=MAGNITUDE, NAME:FORM=MAGNITUDE."""
    found: dict[str, float] = {}
    for word in words:
        key, equals, number = word.partition("=")
        key = key.strip()
        if key in found:
            raise WrongUseError("an effect is given twice", f"{word!r}", "give each once")
        found[key] = _magnitude(word, number) if equals else middle(_candidates(plant, key)[0])
    return found


def _magnitude(word: str, number: str) -> float:
    try:
        return float(number)
    except ValueError:
        raise WrongUseError("an effect is NAME=MAGNITUDE", f"{word!r}", "give the magnitude as a number") from None


def chosen(plant: Any, key: str, magnitude: float) -> tuple[EffectForm, Effect]:
    """The form that NAME or NAME:FORM means at a magnitude, and the effect; refuses what no form can have."""
    forms = _candidates(plant, key)
    for form in forms:
        low, high = bounds(form)
        if low <= magnitude <= high:
            return form, form.at(magnitude)
    ranges = list(dict.fromkeys(_range(form) for form in forms))
    raise WrongUseError(f"the magnitude of {key} lies between {' or '.join(ranges)}", f"{magnitude:g}")


def _range(form: EffectForm) -> str:
    low, high = bounds(form)
    return f"{low:g} and {high:g} {f'({form.quantity})' if form.quantity else form.unit}"


def _candidates(plant: Any, key: str) -> tuple[EffectForm, ...]:
    name, colon, number = key.partition(":")
    forms = forms_of(plant, name)
    if not colon:
        return forms
    if number not in {str(k + 1) for k in range(len(forms))}:
        listed = "; ".join(f"{k + 1} {form.form}" for k, form in enumerate(forms))
        raise WrongUseError(f"{name} has no such form", f"{number!r}", f"its forms are {listed}")
    return (forms[int(number) - 1],)


def moves(plant: Any, effects: Mapping[str, float], others: Sequence[str] = ()) -> dict[str, float]:
    """Parameters of the plant that effects move, together; {} for none.

    `others` are parameters that something else changes. Refuses an effect that moves one of these, or two effects
    that want different values of one parameter: the answer would depend on the order.
    """
    found: dict[str, float] = {}
    whose: dict[str, str] = {}
    names = [key.partition(":")[0] for key in effects]
    if twice := [name for name in names if names.count(name) > 1]:
        raise WrongUseError("an effect is given twice", twice[0], "give each once")
    for key, magnitude in effects.items():
        for name, value in chosen(plant, key, magnitude)[1].moves.items():
            if name in others:
                raise WrongUseError(
                    f"the effect {key} moves a parameter that the study changes too", name, "leave one of both out"
                )
            if found.setdefault(name, value) != value:
                raise WrongUseError(
                    f"the effects {whose[name]} and {key} want different values of one parameter",
                    f"{name} = {found[name]:g} and {value:g}",
                    "choose another form, NAME:FORM, of one of them",
                )
            whose.setdefault(name, key)
    return found
