"""Image messages as gray levels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np

from fvslam_graph.core.camera import MAX_SIDE
from fvslam_graph.sequences.images import Levels, decode_bytes
from fvslam_graph.sequences.ros.reader import Bag, stamp_of

RAW_IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"


class Encoding(NamedTuple):
    """The storage of a raw image.

    Attributes:
        dtype: Of a number.
        channels: Numbers a pixel.
        to_gray: OpenCV's conversion; None where it is gray.
    """

    dtype: str = "u1"
    channels: int = 1
    to_gray: int | None = None


# As sensor_msgs/image_encodings.hpp names them; a Bayer pattern by the colours of its first two rows.
ENCODINGS = {
    "mono8": Encoding(),
    "8uc1": Encoding(),
    "mono16": Encoding("u2"),
    "16uc1": Encoding("u2"),
    "rgb8": Encoding("u1", 3, cv2.COLOR_RGB2GRAY),
    "bgr8": Encoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "8uc3": Encoding("u1", 3, cv2.COLOR_BGR2GRAY),
    "rgba8": Encoding("u1", 4, cv2.COLOR_RGBA2GRAY),
    "bgra8": Encoding("u1", 4, cv2.COLOR_BGRA2GRAY),
    "bayer_rggb8": Encoding("u1", 1, cv2.COLOR_BayerRGGB2GRAY),
    "bayer_bggr8": Encoding("u1", 1, cv2.COLOR_BayerBGGR2GRAY),
    "bayer_gbrg8": Encoding("u1", 1, cv2.COLOR_BayerGBRG2GRAY),
    "bayer_grbg8": Encoding("u1", 1, cv2.COLOR_BayerGRBG2GRAY),
}


@dataclass(frozen=True, slots=True)
class ImageMessage:
    """The place of an image in a bag.

    Attributes:
        topic: Its topic.
        received: When it was received, ns.
        stamp: The time in its header, ns.
    """

    topic: str
    received: int
    stamp: int

    @property
    def name(self) -> str:
        """The time by which it is told from the others."""
        return f"that of {(self.stamp or self.received) / 1e9:.3f} s"

    def __str__(self) -> str:
        return f"{self.topic}, {self.name}"

    def decode(self, bag: Bag) -> Levels | None:
        """Its gray levels, (H, W); None where there are none to read."""
        messages = [message for message in bag.at(self.topic, self.received) if stamp_of(message) == self.stamp]
        return gray_levels(messages[0]) if messages else None


def gray_levels(message: Any) -> Levels | None:
    """Gray levels (H, W) uint8 or uint16 of a raw or compressed image; None where there are none to read."""
    if not hasattr(message, "encoding"):
        return decode_bytes(message.data.tobytes())
    encoding = ENCODINGS.get(message.encoding.lower())
    if encoding is None or not (0 < message.width <= MAX_SIDE and 0 < message.height <= MAX_SIDE):
        return None
    dtype = np.dtype(encoding.dtype).newbyteorder(">" if message.is_bigendian else "<")
    row = message.width * encoding.channels * dtype.itemsize
    if message.step < row or len(message.data) < message.step * message.height:
        return None
    rows = message.data[: message.step * message.height].reshape(message.height, message.step)[:, :row]
    values = np.ascontiguousarray(rows).view(dtype).reshape(message.height, message.width, encoding.channels)
    values = values.astype(encoding.dtype, copy=False)
    levels: Levels = values[..., 0] if encoding.to_gray is None else cv2.cvtColor(values, encoding.to_gray)
    return levels
