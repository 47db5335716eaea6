"""ROS 1 and ROS 2 bags (a file, or the folder of a ROS 2 bag), by the library rosbags."""

from pathlib import Path

from tiltcal.core.errors import TiltcalError
from tiltcal.core.optional_library import library
from tiltcal.recordings.formats.budget import Budget
from tiltcal.recordings.formats.raw_table import RawFile
from tiltcal.recordings.formats.ros_messages import Topic

_MESSAGE = 1000  # bytes that a message takes as a row of values, about


def read_bag(path: Path, budget: Budget) -> RawFile:
    """One table a topic.

    Raises:
        TiltcalError: the library is missing, there are no messages, or too many.
    """
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
