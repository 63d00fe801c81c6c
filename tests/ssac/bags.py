"""ROS bags of events and points, which the library rosbags writes."""

import shutil
from functools import cache, partial
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.ssac.synthetic import HEIGHT, WIDTH

_ARRAY = "std_msgs/Header header\nuint32 height\nuint32 width\n{}/Event[] events"
_PACKET = (
    "std_msgs/Header header\nuint32 height\nuint32 width\nuint64 seq\nuint64 time_base\n"
    "string encoding\nbool is_bigendian\nuint8[] events"
)
_EVENT = "uint16 x\nuint16 y\n{} ts\nbool polarity"
PACKETS, POINTS = "event_camera_msgs/msg/EventPacket", "geometry_msgs/msg/PointStamped"
PER_MESSAGE = 100


@cache
def store(is_ros1):
    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    time = "time" if is_ros1 else "builtin_interfaces/Time"
    for package in ("dvs_msgs", "prophesee_event_msgs"):
        types.register(get_types_from_msg(_EVENT.format(time), f"{package}/msg/Event"))
        types.register(get_types_from_msg(_ARRAY.format(package), f"{package}/msg/EventArray"))
    types.register(get_types_from_msg(_PACKET, PACKETS))
    return types


def write_bag(path, topics):
    """Write a bag in the format of the extension; each topic has a type and a list of messages.

    Each message is a pair of a time [us] and a function that makes its fields from the bag's types.
    """
    is_ros1, is_alone = path.suffix == ".bag", path.suffix in (".mcap", ".db3")
    types = store(is_ros1)
    header = partial(types.types["std_msgs/msg/Header"], *((3,) if is_ros1 else ()))
    plugins = rosbag2.StoragePlugin
    storage = plugins.MCAP if path.suffix == ".mcap" else plugins.SQLITE3
    how = {} if is_ros1 else {"version": 9, "storage_plugin": storage}
    made = Path(mkdtemp(dir=path.parent)) / path.stem
    with (rosbag1.Writer if is_ros1 else rosbag2.Writer)(made, **how) as writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=types)
            for t_us, fields in messages:
                about = header(_time(types)(t_us), "camera frame")
                message = types.types[kind](header=about, **fields(types))
                serialize = types.serialize_ros1 if is_ros1 else types.serialize_cdr
                # A bag's own time is half a second later, so that it is no time of an event.
                writer.write(connection, int(t_us * 1000) + 10**9 // 2, serialize(message, kind))
    (next(made.glob(f"*{path.suffix}")) if is_alone else made).replace(path)
    shutil.rmtree(made.parent)
    return path


def arrays(events, package="dvs_msgs"):
    def fields(some, types):
        event, time = types.types[f"{package}/msg/Event"], _time(types)
        listed = [event(x, y, time(t), bool(p)) for t, x, y, p in some.tolist()]
        return {"height": HEIGHT, "width": WIDTH, "events": listed}

    messages = [(some["t"][0], partial(fields, some)) for some in parts(events)]
    return f"{package}/msg/EventArray", messages


def packets(encoding, data, is_bigendian=False):
    """Messages of encoded events; `data` holds the base time [us] and the bytes of each."""

    def fields(t_us, some, types):
        return {
            "height": HEIGHT, "width": WIDTH, "seq": 7, "time_base": int(t_us) * 1000,
            "encoding": encoding, "is_bigendian": is_bigendian,
            "events": np.frombuffer(some, np.uint8),
        }  # fmt: skip

    return PACKETS, [(t_us, partial(fields, t_us, some)) for t_us, some in data]


def mono(events, order="<"):
    data = []
    for some in parts(events):
        t, x, y, p = (some[name].astype(np.uint64) for name in "txyp")
        since_ns = (t - t[0]) * np.uint64(1000)
        words = p << np.uint64(63) | y << np.uint64(48) | x << np.uint64(32) | since_ns
        data.append((int(some["t"][0]), words.astype(f"{order}u8").tobytes()))
    return packets("mono", data, order == ">")


def points(track):
    def fields(x, y, types):
        return {"point": types.types["geometry_msgs/msg/Point"](x, y, 0.0)}

    rows = np.column_stack([track.times_s, track.points_px]).tolist()
    return POINTS, [(1e6 * t_s, partial(fields, x, y)) for t_s, x, y in rows]


def parts(events):
    return [events[k : k + PER_MESSAGE] for k in range(0, len(events), PER_MESSAGE)]


def _time(types):
    time = types.types["builtin_interfaces/msg/Time"]
    return lambda t_us: time(*divmod(int(t_us * 1000), 10**9))
