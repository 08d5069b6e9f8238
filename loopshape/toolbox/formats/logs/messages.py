"""Logs of messages: MCAP, and bags of ROS 1 and 2 (extra `ros`: mcap, rosbags).

A signal is `TOPIC.FIELD`, of inner fields `TOPIC.outer.inner`, of short lists `TOPIC.FIELD[0]`. The stamps of a topic
are `time of TOPIC`, in s since the first message: its `header.stamp` or `timestamp` where every message bears one that
rises, else the time of logging. Messages of MCAP are JSON, protobuf, ROS 1 or CDR (ROS 2); topics in other encodings,
and fields that are no signals, are left out and listed as not read.

Messages that name joints (`sensor_msgs/JointState`: `name`; of trajectory controllers: `joint_names`) give signals by
joint, `TOPIC.JOINT.position`, each message matched by its own names; a joint that is not in every message has stamps
of its own, `time of TOPIC.JOINT.position`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from loopshape.core.errors import UnreadableInputError
from loopshape.io.files import reading
from loopshape.io.size_limit import most_bytes
from loopshape.toolbox.formats.logs.mdf4 import TIME_OF, Arrays

_PER_S = 1e9  # stamps count nanoseconds
_LONGEST_LIST = 16  # numbers of a field that become signals
_DEEPEST = 6
_MAGIC_1 = b"#ROSBAG V2.0"
_STAMPS = ("header.stamp.", "timestamp.")
_JOINTS = ("name", "joint_names")  # fields that name the joints whose numbers stand in the lists beside them
#: lists of a number a joint, and the unit that ROS defines for joints that turn (REP 103)
_OF_JOINTS = {
    **dict.fromkeys(("position", "positions"), "rad"), **dict.fromkeys(("velocity", "velocities"), "rad/s"),
    **dict.fromkeys(("accelerations",), "rad/s2"), "effort": "N m",
}  # fmt: skip
_TURNING = (
    "joints are taken for ones that turn, in the units of ROS (rad, rad/s, N m): of one that slides write m, m/s, N and"
    " end the stored names so."
)

#: a topic's name, its time of logging in ns, and its message as nested tables or dataclasses
Message = tuple[str, int, Any]


def read_mcap(path: Path) -> Arrays:
    """Signals (n,) and stamps by name of an MCAP file. Refuses a missing extra, and a damaged file."""
    try:
        from mcap.reader import make_reader
    except ImportError:
        raise _missing(path) from None
    decode: dict[int, Callable[[bytes], Any] | None] = {}
    closed: list[str] = []

    def messages() -> Iterator[Message]:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if channel.id not in decode:
                    decode[channel.id] = _decoder(path, schema, channel.message_encoding)
                if (known := decode[channel.id]) is not None:
                    yield channel.topic, message.log_time, known(message.data)
                elif (unknown := f"{channel.topic} (encoded as {channel.message_encoding})") not in closed:
                    closed.append(unknown)

    with reading(path, "MCAP", Exception):
        return _signals(path, messages(), closed)


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


def read_bag(path: Path) -> Arrays:
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


def _signals(path: Path, messages: Iterator[Message], closed: Collection[str] = ()) -> Arrays:
    """Signals of all topics; fields that are no numbers, or not in every message of their topic, are `closed`."""
    left: dict[str, None] = {}
    logged: dict[str, list[int]] = {}
    rows: dict[str, dict[str, list[float]]] = {}
    stamped: dict[str, list[int]] = {}
    joints: dict[str, _OfJoint] = {}
    room = most_bytes(path) // 32  # bytes of a number in a list
    for topic, time_ns, message in messages:
        logged.setdefault(topic, []).append(time_ns)
        own = rows.setdefault(topic, {})
        for name, value, unit in _numbers(message, "", 0, _joints(message)):
            if isinstance(value, str):
                left[f"{topic}.{name} ({value})"] = None
                continue
            own.setdefault(name, []).append(value)
            room -= 1
            if unit is not None:
                joints.setdefault(f"{topic}.{name}", _OfJoint(unit, [])).at.append(len(logged[topic]) - 1)
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
        by_own = t.tolist() == stamped.get(topic)  # then its stamps are no signals
        for name, values in rows[topic].items():
            whole = f"{topic}.{name}"
            if len(values) == t.size and not (by_own and name.startswith(_STAMPS)):
                found[whole] = np.array(values)
            elif len(values) != t.size and whole in joints:
                found |= {whole: np.array(values), TIME_OF + whole: (t[joints[whole].at] - first) / _PER_S}
            elif len(values) != t.size:
                left[f"{whole} (not in every message)"] = None
        found[TIME_OF + topic] = (t - first) / _PER_S
    units = {name: joint.unit for name, joint in joints.items()}
    return Arrays(found, (*closed, *left), units, [_TURNING] if units else [])  # closed stands there by now


@dataclass
class _OfJoint:
    """A joint's signal: its unit, and the messages of its topic that hold it."""

    unit: str
    at: list[int]


def _times(logged: list[int], stamped: list[int]) -> np.ndarray:
    """Stamps (n,) of a topic in ns: its own where they are whole and rise, else those of logging."""
    own = np.array(stamped, dtype=np.int64)
    return own if own.size == len(logged) and np.all(np.diff(own) > 0) else np.array(logged, dtype=np.int64)


def _items(message: Any) -> Iterator[tuple[str, Any]]:
    if is_dataclass(message):
        yield from ((f.name, getattr(message, f.name)) for f in fields(message) if not f.name.startswith("__"))
    elif isinstance(message, dict):
        yield from ((str(key), value) for key, value in message.items())


def _joints(message: Any) -> Sequence[str]:
    """Names of the joints of a message whose lists stand in their order; empty for other messages."""
    own = dict(_items(message))
    names = next((own[key] for key in _JOINTS if isinstance(own.get(key), list | tuple)), ())
    return names if all(isinstance(x, str) and x for x in names) and len(set(names)) == len(names) else ()


def _numbers(
    message: Any, outer: str, depth: int, joints: Sequence[str] = ()
) -> Iterator[tuple[str, float | str, str | None]]:
    """Names and values of the numbers within a message; of a text, a long list, and what lies too deep, why not.

    The third is the unit of a joint's number, None of others.
    """
    for key, value in _items(message):
        name = f"{outer}.{key}" if outer else key
        if isinstance(value, bool | int | float | np.number | np.bool_):
            yield name, float(value), None
        elif isinstance(value, list | tuple | np.ndarray):
            yield from _of_list(name, key, value, joints)
        elif depth < _DEEPEST and (isinstance(value, dict) or is_dataclass(value)):
            yield from _numbers(value, name, depth + 1, joints)
        elif value is not None:
            yield name, "no number" if depth < _DEEPEST else "too deep", None


def _of_list(
    name: str, key: str, values: Sequence[Any] | np.ndarray, joints: Sequence[str]
) -> Iterator[tuple[str, float | str, str | None]]:
    """The numbers of a list, by joint where it holds one for each."""
    if joints and key in _JOINTS:
        return
    by_joint = bool(joints) and key in _OF_JOINTS and len(values) == len(joints)
    if len(values) > _LONGEST_LIST and not by_joint:
        yield name, f"a list of more than {_LONGEST_LIST}", None
    elif not all(isinstance(x, int | float | np.number) for x in values):
        yield name, "no numbers", None
    elif by_joint:
        yield from ((f"{joint}.{name}", float(x), _OF_JOINTS[key]) for joint, x in zip(joints, values, strict=True))
    else:
        yield from ((f"{name}[{k}]", float(x), None) for k, x in enumerate(values))


def _stamp(message: Any) -> int | None:
    """`header.stamp` or `timestamp` in ns, None without one."""
    own = dict(_items(message))
    inner = dict(_items(dict(_items(own.get("header"))).get("stamp", own.get("timestamp"))))
    whole = next((inner[name] for name in ("sec", "secs", "seconds") if name in inner), None)
    part = next((inner[name] for name in ("nanosec", "nsec", "nsecs", "nanos") if name in inner), None)
    if not isinstance(whole, int | np.integer) or not isinstance(part, int | np.integer) or whole <= 0:
        return None
    return int(whole) * 1_000_000_000 + int(part)
