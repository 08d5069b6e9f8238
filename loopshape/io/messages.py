"""Logs of messages: MCAP, and bags of ROS 1 and 2 (extra `ros`: mcap, rosbags).

A signal is `TOPIC.FIELD`, of inner fields `TOPIC.outer.inner`, of short lists `TOPIC.FIELD[0]`. The stamps of a topic
are `time of TOPIC`, in s since the first message: its `header.stamp` or `timestamp` where every message bears one that
rises, else the time of logging. Messages of MCAP are JSON, protobuf, ROS 1 or CDR (ROS 2); topics in other encodings
are left out.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading
from loopshape.io.growth import most_bytes
from loopshape.io.mdf4 import TIME_OF

_PER_S = 1e9  # stamps count nanoseconds
_LONGEST_LIST = 16  # numbers of a field that become signals
_DEEPEST = 6
_MAGIC_1 = b"#ROSBAG V2.0"

#: a topic's name, its time of logging in ns, and its message as nested tables or dataclasses
Message = tuple[str, int, Any]


def read_mcap(path: Path) -> dict[str, np.ndarray]:
    """Signals (n,) and stamps by name of an MCAP file. Refuses a missing extra, and a damaged file."""
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise _missing(path) from None
    decode: dict[int, Callable[[bytes], Any] | None] = {}

    def messages() -> Iterator[Message]:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if channel.id not in decode:
                    decode[channel.id] = _decoder(path, schema, channel.message_encoding)
                if (known := decode[channel.id]) is not None:
                    yield channel.topic, message.log_time, known(message.data)

    with reading(path, "MCAP", Exception):
        return _signals(path, messages())


def _decoder(path: Path, schema: Any, encoding: str) -> Callable[[bytes], Any] | None:
    """How messages of a channel are read; None for encodings that are not known."""
    if encoding == "json":
        return json.loads
    if encoding == "protobuf" and schema is not None and schema.encoding == "protobuf":
        return _protobuf(path, schema)
    if encoding not in ("cdr", "ros1") or schema is None:
        return None
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise _missing(path) from None
    store = get_typestore(Stores.EMPTY)
    kind = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
    store.register(get_types_from_msg(schema.data.decode(), kind))
    read = store.deserialize_cdr if encoding == "cdr" else store.deserialize_ros1
    return lambda data: read(data, kind)


def _protobuf(path: Path, schema: Any) -> Callable[[bytes], Any]:
    """Messages of a type that the log itself describes (a `FileDescriptorSet`), as nested tables."""
    try:
        from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    except ImportError:
        raise _missing(path) from None
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
    return lambda data: _table(kind.FromString(data))


def _table(message: Any) -> dict[str, Any]:
    """Each field with its value, also zeros, which protobuf does not send; a message that is not there is left out."""
    rows = {}
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            rows[field.name] = list(value) if field.is_repeated else value
        elif not field.is_repeated and message.HasField(field.name):
            rows[field.name] = _table(value)
    return rows


def read_bag(path: Path) -> dict[str, np.ndarray]:
    """Signals (n,) and stamps by name of a bag: a `.bag` of ROS 1, or the `.db3` of a ROS 2 folder with its metadata.

    Refuses a missing extra, and a damaged bag.
    """
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise _missing(path) from None
    with reading(path, "a bag of ROS", Exception):
        with path.open("rb") as file:
            first = file.read(len(_MAGIC_1)) == _MAGIC_1
        known = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
        with AnyReader([path if first else path.parent], default_typestore=known) as bag:
            return _signals(path, ((c.topic, t, bag.deserialize(data, c.msgtype)) for c, t, data in bag.messages()))


def _missing(path: Path) -> UnreadableInputError:
    return UnreadableInputError(
        f"{path.name} is a log of messages, which needs mcap, protobuf and rosbags", path.suffix,
        "install them: pip install 'loopshape[ros]'",
    )  # fmt: skip


def _signals(path: Path, messages: Iterator[Message]) -> dict[str, np.ndarray]:
    """Signals of all topics; fields that are no numbers, or not in every message of their topic, are left out."""
    logged: dict[str, list[int]] = {}
    rows: dict[str, dict[str, list[float]]] = {}
    stamped: dict[str, list[int]] = {}
    room = most_bytes(path) // 32  # bytes of a number in a list
    for topic, time_ns, message in messages:
        logged.setdefault(topic, []).append(time_ns)
        own = rows.setdefault(topic, {})
        for name, value in _numbers(message, "", 0):
            own.setdefault(name, []).append(value)
            room -= 1
        if (stamp := _stamp(message)) is not None:
            stamped.setdefault(topic, []).append(stamp)
        if room < 0:
            raise ValueError("its messages hold more numbers than its size can carry")
    if not logged:
        raise ValueError("it holds no messages of a known encoding")
    found: dict[str, np.ndarray] = {}
    times = {topic: _times(logged[topic], stamped.get(topic, [])) for topic in logged}
    first = min(int(t[0]) for t in times.values())
    for topic, t in times.items():
        found |= {f"{topic}.{name}": np.array(v) for name, v in rows[topic].items() if len(v) == t.size}
        found[TIME_OF + topic] = (t - first) / _PER_S
    return found


def _times(logged: list[int], stamped: list[int]) -> np.ndarray:
    """Stamps (n,) of a topic in ns: its own where they are whole and rise, else those of logging."""
    own = np.array(stamped, dtype=np.int64)
    return own if own.size == len(logged) and np.all(np.diff(own) > 0) else np.array(logged, dtype=np.int64)


def _items(message: Any) -> Iterator[tuple[str, Any]]:
    if is_dataclass(message):
        yield from ((f.name, getattr(message, f.name)) for f in fields(message) if not f.name.startswith("__"))
    elif isinstance(message, dict):
        yield from ((str(key), value) for key, value in message.items())


def _numbers(message: Any, outer: str, depth: int) -> Iterator[tuple[str, float]]:
    """Names and values of the numbers within a message; a long list, and what lies too deep, is left out."""
    for key, value in _items(message):
        name = f"{outer}.{key}" if outer else key
        if isinstance(value, bool | int | float | np.number | np.bool_):
            yield name, float(value)
        elif isinstance(value, list | tuple | np.ndarray) and len(value) <= _LONGEST_LIST:
            plain = all(isinstance(x, int | float | np.number) for x in value)
            yield from ((f"{name}[{k}]", float(x)) for k, x in enumerate(value) if plain)
        elif depth < _DEEPEST:
            yield from _numbers(value, name, depth + 1)


def _stamp(message: Any) -> int | None:
    """`header.stamp` or `timestamp` in ns, None without one."""
    own = dict(_items(message))
    inner = dict(_items(dict(_items(own.get("header"))).get("stamp", own.get("timestamp"))))
    whole = next((inner[name] for name in ("sec", "secs", "seconds") if name in inner), None)
    part = next((inner[name] for name in ("nanosec", "nsec", "nsecs", "nanos") if name in inner), None)
    if not isinstance(whole, int | np.integer) or not isinstance(part, int | np.integer) or whole <= 0:
        return None
    return int(whole) * 1_000_000_000 + int(part)
