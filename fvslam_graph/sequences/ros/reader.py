"""A ROS 1 or ROS 2 bag: its topics, one pass through its messages, and any one of them again."""

from __future__ import annotations

import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from fvslam_graph.core.errors import SequenceError
from fvslam_graph.core.extras import require

MEND = "a recording that was cut off is mended by `rosbag reindex`, `ros2 bag reindex` or `mcap recover`"

Rows = dict[str, list[tuple[int, Any]]]
"""For each topic, the messages: the time of receipt (ns) and what was taken of it."""


@dataclass(frozen=True)
class Topic:
    """A topic with messages.

    Attributes:
        name: Such as "/camera/image_raw".
        type: As ROS 2 spells it, also of ROS 1: "sensor_msgs/msg/Image".
        count: Number of messages.
    """

    name: str
    type: str
    count: int


class Bag:
    """A bag that is kept open. Messages come as rosbags makes them, with the fields of their definition.

    Args:
        path: A .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.

    Attributes:
        topics: Those with messages, by name.

    Raises:
        SequenceError: The file is damaged or no bag.
        FvslamError: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        require("bags")
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore

        self.path = path
        try:
            # Bags of ROS 2 before Iron do not define their messages.
            self._reader = AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
            self._reader.open()
            weakref.finalize(self, self._reader.close)
            self.topics = {
                name: Topic(name, info.msgtype, int(info.msgcount))
                for name, info in sorted(self._reader.topics.items())
                if info.msgcount and info.msgtype
            }
        except Exception as problem:  # what a damaged file raises has no common base
            raise SequenceError(f"{path} cannot be read as a bag: {_reason(problem)}; {MEND}") from None

    def of_type(self, *types: str) -> list[Topic]:
        """The topics of these types."""
        return [topic for topic in self.topics.values() if topic.type in types]

    def first(self, topic: str) -> Any:
        """The first message of a topic.

        Raises:
            SequenceError: It cannot be read.
        """
        try:
            return next(message() for _, _, message in self._messages([topic]))
        except Exception as problem:
            raise SequenceError(f"{self.path}: the first message of {topic} is damaged: {_reason(problem)}") from None

    def at(self, topic: str, received: int) -> list[Any]:
        """The messages of a topic that were received at this time, ns; none where they are damaged."""
        try:
            return [message() for _, _, message in self._messages([topic], received, received + 1)]
        except Exception:
            return []

    def collect(self, takes: Mapping[str, Callable[[Any], Any]]) -> tuple[Rows, tuple[str, ...]]:
        """Take what is wanted of all messages of several topics, in one pass.

        Args:
            takes: By topic, what to take of a message; a message of which it is None is left out.

        Returns:
            What was taken, and notes on what is damaged.
        """
        rows: Rows = {topic: [] for topic in takes}
        damaged: Counter[str] = Counter()
        notes = []
        try:
            for topic, received, message in self._messages(takes):
                try:
                    taken = takes[topic](message())
                except Exception:
                    damaged[topic] += 1
                    continue
                if taken is not None:
                    rows[topic].append((received, taken))
        except Exception as problem:
            count = sum(map(len, rows.values()))
            notes.append(f"the bag is damaged, and is read up to message {count}: {_reason(problem)}; {MEND}")
        notes += [f"{count} damaged messages of {topic} are left out" for topic, count in damaged.items()]
        return rows, tuple(notes)

    def _messages(
        self, topics: Mapping[str, Any] | list[str], start: int | None = None, stop: int | None = None
    ) -> Iterator[tuple[str, int, Callable[[], Any]]]:
        """Topic, time of receipt (ns), and a function that makes the message."""
        connections = [connection for connection in self._reader.connections if connection.topic in topics]
        if not connections:  # to the library, none are all
            return
        for connection, received, data in self._reader.messages(connections, start, stop):
            yield connection.topic, received, partial(self._reader.deserialize, data, connection.msgtype)


def stamp_of(message: Any) -> int:
    """The time in a message's header, ns; 0 where nobody has set it."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def _reason(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200].rstrip(".") or type(problem).__name__
