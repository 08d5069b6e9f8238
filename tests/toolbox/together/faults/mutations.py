"""What is done to a file: bytes changed, cut, doubled; words and numbers of its tables replaced.

Every mutation follows from its seed.
"""

import json
import random
import tomllib

import tomli_w

NUMBERS = (float("nan"), float("inf"), float("-inf"), 1e308, -1e308, 5e-324, 10**400, 2**63, -1, 0, 0.0)
WRONG = ("words", True, [], {}, [[1.0]], {"a": 1}, "", "../outside", "/etc/hostname", "a\0b", "x" * 5000, [1] * 300)
NOT_NUMBERS = (float("nan"), "words", [], {}, [[1.0]], {"a": 1})
TABLES = {"toml": (tomllib.loads, tomli_w.dumps), "json": (json.loads, json.dumps)}
LENGTHS = (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\0\0\0\0", b"\0\0\0\x80")


def of_bytes(content, rng):
    """Bytes with bits flipped, cut short, zeroed, doubled, shuffled, or with a length that lies."""
    data, at = bytearray(content), rng.randrange(max(len(content), 1))
    size = rng.choice((1, 4, 64, 4096))
    match rng.randrange(9):
        case 0:
            for _ in range(rng.choice((1, 3, 30))):
                data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        case 1:
            del data[at:]
        case 2:
            data[at : at + size] = bytes(len(data[at : at + size]))
        case 3:
            data[at : at + 4] = rng.choice(LENGTHS)
        case 4:
            data[at:at] = data[at : at + size]
        case 5:
            del data[at : at + size]
        case 6:
            data[at:at] = rng.randbytes(size)
        case 7:
            data = bytearray(rng.choice((b"", b"\0", b"\n", b"[" * 100_000, b'{"a":' * 100_000, bytes(len(data)))))
        case _:
            data += rng.choice((bytes(size), bytes(data), b"\n", b"]", b"\xff\xfe"))
    return bytes(data)


def of_table(table, rng):
    """A table with one value replaced, taken out, or a key misspelt; and the place."""
    place = rng.choice(list(places(table)))
    match rng.randrange(8):
        case 0:
            return put(table, place, rng.choice(NUMBERS)), place
        case 1:
            return put(table, place, rng.choice(WRONG)), place
        case 2:
            return put(table, place), place
        case 3:
            return put(table, place, deep(rng.choice((3, 100)))), place
        case 4:
            return put(table, place, [value(table, place)]), place
        case 5:
            old = value(table, place)
            return put(table, place, -old if isinstance(old, int | float) else f"{old}x"), place
        case 6:
            old = value(table, place)
            return put(table, place, old * 10**9 if isinstance(old, int | float) else rng.choice(WRONG)), place
        case _:
            return put(table, place, rng.choice(NOT_NUMBERS)), place


def deep(levels):
    """Lists within lists."""
    made = []
    for _ in range(levels):
        made = [made]
    return made


def places(table, path=()):
    """Every place in nested tables and lists."""
    inner = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, one in inner:
        yield (*path, key)
        yield from places(one, (*path, key))


def value(table, place, *otherwise):
    """What stands at a place."""
    try:
        for key in place:
            table = table[key]
    except (KeyError, IndexError, TypeError):
        return otherwise[0]
    return table


def put(table, place, *new):
    """A copy with another value at a place, or without it."""
    copy, (key, *rest) = (dict if isinstance(table, dict) else list)(table), place
    if rest:
        copy[key] = put(copy[key], rest, *new)
    elif new:
        copy[key] = new[0]
    else:
        del copy[key]
    return copy


def mutated(name, content, seed):
    """The bytes of a file of this name after its mutation of this number, what was done, and whether it is nonsense.

    Nonsense is what is no finite number in a number's place.
    """
    rng = random.Random(f"{name} {seed}")
    kind = name.rpartition(".")[2]
    if kind not in TABLES or rng.random() < 0.3:
        return of_bytes(content, rng), "bytes", False
    read, write = TABLES[kind]
    table = read(content.decode())
    changed, place = of_table(table, rng)
    old, new = value(table, place), value(changed, place, "gone")
    number = isinstance(old, int | float) and not isinstance(old, bool)
    nonsense = number and new != "gone" and (isinstance(new, str | list | dict) or new != new)
    return write(changed).encode(), f"{place}: {str(old)[:60]} -> {str(new)[:60]}", nonsense
