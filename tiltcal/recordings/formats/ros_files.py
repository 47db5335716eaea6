"""Files of ROS: MCAP (messages of ROS 1 and ROS 2, and JSON), and bags of ROS 1 and ROS 2 (a file,
or the folder of a ROS 2 bag), by the library rosbags.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tiltcal.core.errors import TiltcalError
from tiltcal.core.optional_library import library
from tiltcal.recordings.formats.budget import ReadBudget
from tiltcal.recordings.formats.raw_table import RawFile
from tiltcal.recordings.formats.ros_messages import Topic

_MARK = b"#ROSBAG V"
_MESSAGE = 1000  # bytes that a message takes as a row of values, about
_FORMAT = "MCAP files"


def read_mcap(path: Path, budget: ReadBudget) -> RawFile:
    """One table a topic.

    Raises:
        TiltcalError: a library is missing, the messages are in another encoding, or too many.
    """
    reader = library("mcap.reader", "mcap", _FORMAT)
    topics: dict[str, Topic] = {}
    others: set[str] = set()
    decoders: dict[int, Callable[[bytes], Any] | None] = {}
    with path.open("rb") as file:
        source = reader.make_reader(file)
        _require_free_space(source.get_summary(), path, budget)
        for schema, channel, message in source.iter_messages(log_time_order=False):
            if channel.id not in decoders:
                decoders[channel.id] = _decoder(schema, channel)
            decode = decoders[channel.id]
            if decode is None:
                others.add(channel.message_encoding)
                continue
            kind = schema.name if schema else ""
            topic = topics.setdefault(channel.topic, Topic(channel.topic, _full(kind)))
            topic.add(decode(message.data), message.log_time)
    if others and not topics:
        raise TiltcalError(
            f"foreign recording {path.name}",
            found=f"messages encoded as {', '.join(sorted(others))}",
            need="cdr, ros1 or json",
            do="convert the file",
        )
    if not topics:
        raise no_messages(path.name)
    return RawFile(path.name, "MCAP", tuple(t.table() for t in topics.values()))


def _require_free_space(summary: Any, path: Path, budget: ReadBudget) -> None:
    """Refuse too much before any chunk is decompressed."""
    if summary is None or not summary.chunk_indexes:
        budget.require(_expanded(path), path.name)
        return
    packed = sum(float(c.uncompressed_size) for c in summary.chunk_indexes)
    count = float(summary.statistics.message_count) if summary.statistics else 0.0
    budget.require(max(packed, _MESSAGE * count), path.name)


def _expanded(path: Path) -> float:
    """Bytes of all chunks of a file without an index, as the chunks state them."""
    streams = library("mcap.stream_reader", "mcap", _FORMAT)
    with path.open("rb") as file:
        records = streams.StreamReader(file, emit_chunks=True).records
        found = sum(float(getattr(r, "uncompressed_size", 0)) for r in records)
    return max(found, float(path.stat().st_size))


def _full(kind: str) -> str:
    """``sensor_msgs/msg/Imu`` of ``sensor_msgs/Imu``."""
    package, _, name = kind.partition("/")
    return kind if "/" in name else f"{package}/msg/{name}"


def _decoder(schema: Any, channel: Any) -> Callable[[bytes], Any] | None:
    """What turns the bytes of a channel into messages; None where its encoding is not known."""
    if channel.message_encoding == "json":
        return json.loads
    if schema is None or channel.message_encoding not in ("cdr", "ros1"):
        return None
    typesys = library("rosbags.typesys", "mcap", _FORMAT)
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    text, name = schema.data.decode(), _full(schema.name)
    if schema.encoding in ("ros2msg", "ros1msg"):
        store.register(typesys.get_types_from_msg(text, name))
    elif schema.encoding == "ros2idl":
        store.register(typesys.get_types_from_idl(text))
    else:
        return None
    read = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
    return lambda data: read(data, name)


def read_bag(path: Path, budget: ReadBudget) -> RawFile:
    """One table a topic.

    Raises:
        TiltcalError: the library is missing, there are no messages, or too many.
    """
    if path.suffix == ".bag":
        with path.open("rb") as file:
            if file.read(len(_MARK)) != _MARK:  # the library looks for the end of its line
                raise TiltcalError(
                    f"foreign recording {path.name}",
                    found=f"a file that does not begin with {_MARK.decode()}",
                    need="a whole ROS bag",
                    do="check the file, or export it again",
                )
    highlevel = library("rosbags.highlevel", "ros", "ROS bags")
    typesys = library("rosbags.typesys", "ros", "ROS bags")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    topics: dict[str, Topic] = {}
    left_out: set[str] = set()
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        budget.require(_MESSAGE * float(reader.message_count), path.name)
        for connection, received, raw in reader.messages():
            if connection.topic in left_out:
                continue
            try:
                message = reader.deserialize(raw, connection.msgtype)
            except KeyError:
                left_out.add(connection.topic)
                continue
            topic = topics.setdefault(connection.topic, Topic(connection.topic, connection.msgtype))
            topic.add(message, received)
    if not topics:
        raise no_messages(path.name)
    return RawFile(path.name, "ROS bag", tuple(t.table() for t in topics.values()))


def no_messages(source: str) -> TiltcalError:
    """The error of a bag without messages."""
    return TiltcalError(
        f"foreign recording {source}",
        found="no message that can be read",
        need="messages such as sensor_msgs/Imu",
        do="record the topics of the sensors",
    )
