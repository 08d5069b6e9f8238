"""Logs of messages read as the numbers that the format's own library wrote; damaged ones end in a sentence."""

import json
import struct

import numpy as np
import pytest
from run_files import CsvShape

import loopshape as ls
from loopshape.toolbox.formats.drafts.draft_map import draft_map
from loopshape.toolbox.formats.tables.import_file import import_file
from loopshape.toolbox.formats.tables.sources import Place, open_source

N = 200
X = np.sin(0.1 * np.arange(N))
NS = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(N)  # 200 Hz
STATE = "std_msgs/Header header\nfloat64[2] angle\nfloat32 effort\nstring note\nfloat64[] many"
HEADER_2 = "builtin_interfaces/Time stamp\nstring frame_id"


def signal(file, name):
    return np.asarray(open_source(file, CsvShape()).signal(Place(name)))


def write_json_mcap(path):
    from mcap.writer import Writer

    with path.open("wb") as file:
        out = Writer(file)
        out.start()
        schema = out.register_schema("state", "jsonschema", b'{"type": "object"}')
        axis = out.register_channel("/axis", "json", schema)
        other = out.register_channel("/blob", "protobuf", schema)
        for k, t in enumerate(NS.tolist()):
            told = {"x": X[k], "inner": {"ok": True, "pair": [k, 2 * k]}, "name": "a"}
            out.add_message(axis, t, json.dumps(told).encode(), t)
            out.add_message(other, t, b"\x01", t)
        out.finish()


def state_in_protobuf():
    """A message type with a stamp, an inner message, lists and a text, described as a compiler of protobuf would."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2

    file = descriptor_pb2.FileDescriptorProto(name="rig.proto", package="rig", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")
    one, many, F = 1, 3, descriptor_pb2.FieldDescriptorProto
    for name, fields in {
        "Inner": [("ok", F.TYPE_BOOL, one, ""), ("pair", F.TYPE_INT64, many, "")],
        "State": [
            ("timestamp", F.TYPE_MESSAGE, one, ".google.protobuf.Timestamp"), ("x", F.TYPE_DOUBLE, one, ""),
            ("inner", F.TYPE_MESSAGE, one, ".rig.Inner"), ("name", F.TYPE_STRING, one, ""),
            ("absent", F.TYPE_MESSAGE, one, ".rig.Inner"),
        ],
    }.items():  # fmt: skip
        message = file.message_type.add(name=name)
        for k, (word, kind, label, of) in enumerate(fields, start=1):
            message.field.add(name=word, number=k, type=kind, label=label, type_name=of or None)
    pool = descriptor_pool.DescriptorPool()
    for known in (timestamp_pb2.DESCRIPTOR.serialized_pb, file.SerializeToString()):
        pool.AddSerializedFile(known)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName("rig.State"))


def write_protobuf_mcap(path):
    """By the format's own writer: logged 0.1 to 0.7 ms after the message's own stamp."""
    from mcap_protobuf.writer import Writer

    State = state_in_protobuf()
    with path.open("wb") as file, Writer(file) as out:
        for k, t in enumerate(NS.tolist()):
            told = State(x=X[k], name="a", inner={"ok": k % 2 == 0, "pair": [k, 2 * k]})
            told.timestamp.seconds, told.timestamp.nanos = divmod(t, 10**9)
            late = t + 100_000 * (1 + k % 7)
            out.write_message(topic="/axis", message=told, log_time=late, publish_time=late)


def typed(store, k):
    stamp = store.types["builtin_interfaces/msg/Time"](int(NS[k] // 10**9), int(NS[k] % 10**9))
    kind = store.types["std_msgs/msg/Header"]
    header = kind(k, stamp, "a") if len(store.fielddefs["std_msgs/msg/Header"][1]) == 3 else kind(stamp, "a")
    return store.types["rig/msg/State"](
        header, np.array([X[k], -X[k]]), float(np.float32(0.5 * X[k])), "note", np.zeros(k % 3)
    )  # fmt: skip


def write_ros(path):
    """The same messages as a bag of ROS 1 (.bag), of ROS 2 (folder with .db3) or of ROS 2 in MCAP."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(STATE, "rig/msg/State"))
    if first:
        writer, pack = rosbag1.Writer(path), store.serialize_ros1
    else:
        kind = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
        writer, pack = rosbag2.Writer(path.parent / path.stem, version=9, storage_plugin=kind), store.serialize_cdr
    with writer:
        axis = writer.add_connection("/axis", "rig/msg/State", typestore=store)
        for k, t in enumerate(NS.tolist()):
            writer.write(axis, t + 300_000 * (k % 7), pack(typed(store, k), "rig/msg/State"))
    return path if first else next((path.parent / path.stem).glob(f"*{path.suffix}"))


@pytest.mark.short
def test_mcap_with_json_messages(tmp_path):
    pytest.importorskip("mcap")
    write_json_mcap(tmp_path / "a.mcap")
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/axis.x"), X)
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/axis.inner.pair[1]"), 2.0 * np.arange(N))
    np.testing.assert_allclose(signal(tmp_path / "a.mcap", "time of /axis"), np.arange(N) / 200.0, atol=1e-12)
    names = open_source(tmp_path / "a.mcap", CsvShape()).names
    assert not [name for name in names if "blob" in name or "name" in name]
    draft = draft_map(tmp_path / "a.mcap")
    assert draft.rate_hz == 200.0
    assert set(open_source(tmp_path / "a.mcap", CsvShape()).closed) == {
        "/blob (encoded as protobuf)", "/axis.name (no number)",
    }  # fmt: skip
    assert any("not read: /blob (encoded as protobuf), /axis.name (no number)" in guess for guess in draft.guesses)


@pytest.mark.short
def test_mcap_with_protobuf_by_the_message_s_own_stamps(tmp_path):
    pytest.importorskip("mcap_protobuf")
    write_protobuf_mcap(tmp_path / "a.mcap")
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/axis.x"), X)
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/axis.inner.ok"), np.arange(N) % 2 == 0)
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/axis.inner.pair[1]"), 2.0 * np.arange(N))
    np.testing.assert_allclose(signal(tmp_path / "a.mcap", "time of /axis"), np.arange(N) / 200.0, atol=1e-12)
    names = open_source(tmp_path / "a.mcap", CsvShape()).names
    assert not [name for name in names if "absent" in name or name.endswith(".name")]


@pytest.mark.short
@pytest.mark.parametrize("ending", [".bag", ".db3", ".mcap"])
def test_bags_of_ros_by_the_sensor_s_own_stamps(tmp_path, ending):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    file = write_ros(tmp_path / f"log{ending}")
    np.testing.assert_array_equal(signal(file, "/axis.angle[1]"), -X)
    np.testing.assert_array_equal(signal(file, "/axis.effort"), (0.5 * X).astype(np.float32))
    np.testing.assert_allclose(signal(file, "time of /axis"), np.arange(N) / 200.0, atol=1e-12)  # not those of logging
    source = open_source(file, CsvShape())
    assert "/axis.many[0]" not in source.names
    assert "/axis.note (no number)" in source.closed
    assert "/axis.many[0] (not in every message)" in source.closed


FORMATS = {
    128: ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns"), 129: ("RATE", "Qfff", "TimeUS,RDes,R,ROut"),
    130: ("IMU", "QBfc", "TimeUS,I,GyrX,T"), 131: ("MSG", "QZ", "TimeUS,Message"),
    132: ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
}  # fmt: skip


def dataflash(damping=0.0):
    """A log by pymavlink's own table of field types."""
    from pymavlink.DFReader import FORMAT_TO_STRUCT

    packs = {k: "<" + "".join(FORMAT_TO_STRUCT[c][0] for c in f[1]) for k, f in FORMATS.items()}

    def message(kind, *values):
        return b"\xa3\x95" + bytes([kind]) + struct.pack(packs[kind], *values)

    parts = [
        message(128, k, 3 + struct.calcsize(packs[k]), name.encode(), form.encode(), columns.encode())
        for k, (name, form, columns) in FORMATS.items()
    ]
    parts.append(message(132, 0, 130, b"s#Ed", b"F--0"))
    for k in range(N):
        t = 1_000_000 + 2500 * k
        parts.append(message(129, t, 10.0, X[k], 0.1 * X[k]))
        parts += [message(130, t + 10, i, X[k] + i, 2500 + k) for i in (0, 1)]
    parts.append(message(131, 5, b"ArduCopter"))
    return b"".join(parts)


def test_dataflash_is_what_pymavlink_reads(tmp_path):
    reader = pytest.importorskip("pymavlink.DFReader")
    (tmp_path / "a.bin").write_bytes(dataflash())
    log = reader.DFReader_binary(str(tmp_path / "a.bin"))
    rows = [message for message in iter(log.recv_msg, None) if message.get_type() == "IMU" and message.I == 1]
    log.filehandle.close()
    for field in ("GyrX", "T"):
        theirs = np.array([getattr(row, field) for row in rows])
        np.testing.assert_array_equal(signal(tmp_path / "a.bin", f"IMU#1.{field}"), theirs)


def test_dataflash_with_instances_and_multipliers(tmp_path):
    pytest.importorskip("pymavlink")
    (tmp_path / "a.bin").write_bytes(dataflash())
    np.testing.assert_array_equal(signal(tmp_path / "a.bin", "RATE.R"), X.astype(np.float32))
    np.testing.assert_array_equal(signal(tmp_path / "a.bin", "IMU#1.GyrX"), (X + 1).astype(np.float32))
    np.testing.assert_allclose(signal(tmp_path / "a.bin", "IMU.T"), 25.0 + 0.01 * np.arange(N))
    np.testing.assert_allclose(np.diff(signal(tmp_path / "a.bin", "time of RATE")), 0.0025, atol=1e-12)
    (tmp_path / "b.bin").write_bytes(dataflash()[:-5])
    cut = 3 + 8 + 64 - 5
    for name, last in (("a.bin", []), ("b.bin", [f"the last {cut} bytes (no whole message)"])):
        closed = open_source(tmp_path / name, CsvShape()).closed
        assert [one for one in closed if "bytes" in one] == last
        assert {"FMTU.UnitIds (text)", "FMTU.MultIds (text)"} <= set(closed)
    assert "MSG.Message (text)" in open_source(tmp_path / "a.bin", CsvShape()).closed


def test_a_draft_of_a_dataflash_log_takes_the_roll_axis(tmp_path):
    pytest.importorskip("pymavlink")
    (tmp_path / "a.bin").write_bytes(dataflash())
    draft = draft_map(tmp_path / "a.bin")
    assert (draft.rate_hz, draft.roles["RATE.R"], draft.roles["RATE.ROut"]) == (400.0, "output", "control")
    (rule,) = [rule for rule in draft.table["columns"].values() if rule["from"] == "RATE.R"]
    assert rule["unit"] == "deg/s"


@pytest.mark.long
@pytest.mark.parametrize("ending", [".mcap", ".bag", ".db3", ".bin"])
def test_damaged_logs_of_messages_end_in_a_sentence(tmp_path, ending):
    for module in ("mcap", "rosbags", "pymavlink"):
        pytest.importorskip(module)
    path = tmp_path / f"a{ending}"
    if ending == ".bin":
        path.write_bytes(dataflash())
    else:
        path = write_ros(path)
    whole, rng, refused = path.read_bytes(), np.random.default_rng(5), 0
    for k in range(40):
        content = bytearray(whole[: rng.integers(len(whole))] if k % 4 == 0 else whole)
        for place in rng.integers(0, max(len(content), 1), 1 + 3 * (k % 3)):
            if content:
                content[place % min(len(content), 4096) if k % 2 else place] = rng.integers(256)
        path.write_bytes(bytes(content))
        try:
            source = open_source(path, CsvShape())
            for name in source.names:
                source.signal(Place(name))
        except ls.LoopshapeError:
            refused += 1
    assert refused > 8
    path.write_bytes(b"")
    with pytest.raises(ls.errors.UnreadableInputError):
        open_source(path, CsvShape())


BLACKBOX = (
    '"H Product:Blackbox flight data recorder"\nloopIteration, time (us), setpoint[0], gyroADC[0] (deg/s), axisSum[0]\n'
)
SCOPE = """Name;MotorAxis
File;C:\\TwinCAT\\Scope\\axis.svdx
StartTime of export;133500000000000000;Tuesday, 16 January 2024;12:00:00.000

Name;Axis.ActPos;Name;Axis.Torque
SymbolName;MAIN.Axis.ActPos;SymbolName;MAIN.Axis.Torque
Net id;5.1.2.3.1.1;Net id;5.1.2.3.1.1
SampleTime[ms];1;SampleTime[ms];1
Unit;mm;Unit;1

"""


def test_a_codesys_trace_as_text_has_all_its_variables_and_asks_for_the_unit_of_its_stamps(tmp_path):
    """The layout that the manual of CoDeSys 2.3 shows: two lines, names after `Cycle`, numbers between blanks."""
    u = np.round(np.random.default_rng(1).standard_normal(2000), 4)
    y = np.round(np.convolve(u, [0.0, 0.5, 0.3])[:2000] + 0.01 * np.random.default_rng(2).standard_normal(2000), 4)
    rows = "".join(f"{2 * k} {a} {b}\n" for k, (a, b) in enumerate(zip(u, y, strict=True)))
    text = "CoDeSys Trace\nD:\\PROJECTS\\AXIS.PRO\nCycle PLC_PRG.U PLC_PRG.Y\n" + rows
    (tmp_path / "a.txt").write_text(text)
    draft = draft_map(tmp_path / "a.txt")
    assert [one.startswith("'Cycle' rises by 2 a row without a unit") for one in draft.open] == [True]
    assert draft.roles == {"PLC_PRG.U": "control", "PLC_PRG.Y": "output"}
    for column, values in zip(draft.columns, (u, y), strict=True):
        np.testing.assert_array_equal(column.values, values)
    (tmp_path / "a.trace").write_text("<Trace/>")
    with pytest.raises(ls.errors.UnreadableInputError, match=r"save the trace as text \(\.txt\)"):
        draft_map(tmp_path / "a.trace")


def test_twincat_scope_csv_with_a_time_beside_each_channel(tmp_path):
    rows = [f"{k},0;{X[k]:.9f};{k},0;{0.5 * X[k]:.9f}".replace(".", ",") for k in range(N)]
    (tmp_path / "a.csv").write_text(SCOPE + "\n".join(rows) + "\n")
    (tmp_path / "m.toml").write_text(
        'format = "loopshape-map/1"\nrate_hz = 1000.0\ntime = { column = 1, unit = "ms" }\n'
        '[csv]\nseparator = ";"\ndecimal = ","\nheader = false\nskip_rows = 10\n[columns]\n'
        'y_m = { column = 2, unit = "mm" }\nu_1 = { column = 4, unit = "1" }\n'
        '[[loop]]\nname = "x"\ncontrol = "u_1"\noutput = "y_m"\n[recording]\nkind = "noise"\ninjection = "control"\n'
    )
    run = import_file(tmp_path / "a.csv", tmp_path / "m.toml")
    np.testing.assert_allclose(run.recordings[0].column("y_m"), 1e-3 * X, atol=1e-12)
    draft = draft_map(tmp_path / "a.csv")
    assert draft.rate_hz == 1000.0


def test_a_decoded_blackbox_of_betaflight(tmp_path):
    rows = [f"{k}, {k * 250}, {10 * X[k]:.3f}, {9 * X[k]:.3f}, {X[k]:.4f}" for k in range(N)]
    (tmp_path / "a.csv").write_text(BLACKBOX.split("\n", 1)[1] + "\n".join(rows) + "\n")
    draft = draft_map(tmp_path / "a.csv")
    assert draft.rate_hz == 4000.0
    assert {draft.roles.get(n) for n in ("setpoint[0]", "gyroADC[0] (deg/s)", "axisSum[0]")} >= {"reference"}


ARM = ("shoulder", "elbow", "wrist")
WALKS = np.cumsum(np.random.default_rng(3).normal(size=(N, 3, 3)), axis=0)


def joint_values(k):
    """Position, velocity and effort of each joint at message k."""
    return {name: tuple(WALKS[k, i]) for i, name in enumerate(ARM)}


def write_joints(path, names_of):
    """Messages of sensor_msgs/JointState, of the joints `names_of(k)` in that order, and commands 2 ms later."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.ROS2_HUMBLE)
    if first:
        writer, pack = rosbag1.Writer(path), store.serialize_ros1
    else:
        kind = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
        writer, pack = rosbag2.Writer(path.parent / path.stem, version=9, storage_plugin=kind), store.serialize_cdr
    State, Stamp, Header = (
        store.types[t] for t in ("sensor_msgs/msg/JointState", "builtin_interfaces/msg/Time", "std_msgs/msg/Header")
    )
    Number = store.types["std_msgs/msg/Float64"]
    with writer:
        states = writer.add_connection("/joint_states", State.__msgtype__, typestore=store)
        commands = writer.add_connection("/command", Number.__msgtype__, typestore=store)
        for k, t in enumerate(NS.tolist()):
            stamp = Stamp(int(t // 10**9), int(t % 10**9))
            header = Header(k, stamp, "") if first else Header(stamp, "")
            names, values = names_of(k), joint_values(k)
            told = State(header, list(names), *(np.array([values[n][i] for n in names]) for i in range(3)))
            writer.write(states, t + 300_000, pack(told, State.__msgtype__))
            writer.write(commands, t + 2_000_000, pack(Number(X[k]), Number.__msgtype__))
    return path if first else next((path.parent / path.stem).glob(f"*{path.suffix}"))


@pytest.mark.long
@pytest.mark.short
@pytest.mark.parametrize("ending", [".bag", ".db3", ".mcap"])
def test_joint_states_go_by_joint_whatever_the_order_of_names(tmp_path, ending):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    file = write_joints(tmp_path / f"log{ending}", lambda k: ARM[k % 3 :] + ARM[: k % 3])
    source = open_source(file, CsvShape())
    for i, field in enumerate(("position", "velocity", "effort")):
        for name in ARM:
            expected = [joint_values(k)[name][i] for k in range(N)]
            np.testing.assert_array_equal(signal(file, f"/joint_states.{name}.{field}"), expected)
    assert not [name for name in source.names if "[0]" in name]
    assert source.units()["/joint_states.elbow.velocity"] == "rad/s"
    draft = draft_map(file)
    assert draft.rate_hz == 200.0  # by the header's stamps, whose parts are no signals
    assert not [column.name for column in draft.columns if "stamp" in column.name]
    units = {rule["from"]: rule["unit"] for rule in draft.table["columns"].values()}
    assert units["/joint_states.wrist.position"] == "rad"
    assert units["/joint_states.wrist.effort"] in ("N m", "Nm")
    assert any("one that slides" in guess for guess in draft.guesses)


def test_a_joint_that_is_not_in_every_message_has_stamps_of_its_own(tmp_path):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    file = write_joints(tmp_path / "log.mcap", lambda k: ARM if k % 4 == 0 else ARM[:2])
    np.testing.assert_array_equal(signal(file, "/joint_states.wrist.position"), WALKS[::4, 2, 0])
    stamps = signal(file, "time of /joint_states.wrist.position")
    np.testing.assert_allclose(stamps, np.arange(0, N, 4) / 200.0, atol=1e-12)
    rule = next(r for r in draft_map(file).table["columns"].values() if r["from"] == "/joint_states.wrist.position")
    assert rule["time"] == "time of /joint_states.wrist.position"


def test_topics_of_one_length_and_other_stamps_are_brought_to_one_time(tmp_path):
    # a draft that took the rows as they lie would hide 2 ms of the 5 ms between command and answer
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    file = write_joints(tmp_path / "log.mcap", lambda k: ARM)
    rules = {rule["from"]: rule for rule in draft_map(file).table["columns"].values()}
    assert rules["/command.data"]["time"] == "time of /command"
    assert "time" not in rules["/joint_states.elbow.position"]


def test_states_of_a_trajectory_controller_in_json_go_by_joint(tmp_path):
    pytest.importorskip("mcap")
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as file:
        out = Writer(file)
        out.start()
        schema = out.register_schema("state", "jsonschema", b'{"type": "object"}')
        channel = out.register_channel("/arm/state", "json", schema)
        for k, t in enumerate(NS.tolist()):
            point = {"positions": [X[k], -X[k]], "velocities": []}
            told = {"joint_names": ["a", "b"], "reference": point, "feedback": point, "gains": [1.0, 2.0]}
            out.add_message(channel, t, json.dumps(told).encode(), t)
        out.finish()
    np.testing.assert_array_equal(signal(tmp_path / "a.mcap", "/arm/state.b.reference.positions"), -X)
    assert "/arm/state.gains[1]" in open_source(tmp_path / "a.mcap", CsvShape()).names
