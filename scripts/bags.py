"""What scripts that change ROS 1 bags have in common. Needs rosbags."""
from rosbags.typesys import Stores, get_typestore


def add_connections(reader, writer):
    """Makes the connections of one bag known to another; by their numbers in the first."""
    store = get_typestore(Stores.ROS1_NOETIC)
    added = {}
    for c in reader.connections:
        definition = c.msgdef if isinstance(c.msgdef, str) else c.msgdef.data
        more = {"typestore": store} if c.msgtype in store.types else {"msgdef": definition, "md5sum": c.digest}
        added[c.id] = writer.add_connection(c.topic, c.msgtype, **more)
    return added
