"""The newest image of a source that does not wait: what comes while somebody is busy is dropped, and counted."""

from __future__ import annotations

import time
from dataclasses import dataclass
from threading import Condition, Thread
from types import TracebackType
from typing import Protocol

from fvslam_graph.sequences.images import Levels

MIN_PAUSE = 0.005  # seconds between two looks at a source that has nothing new
PAUSE_PER_LOOK = 4.0  # how long the pause is at least, in looks: a fifth of a core, however large a folder is


@dataclass(frozen=True)
class LiveImage:
    """An image as it has come.

    Attributes:
        levels: (H, W) gray levels, as deep as they came.
        stamp: Seconds since 1970.
        arrived: When it was there, in seconds of `time.monotonic`.
        missed: How many images of the source were passed over since the one before.
    """

    levels: Levels
    stamp: float
    arrived: float
    missed: int = 0


class LiveSource(Protocol):
    """Something that images come from."""

    name: str
    """What it is, for people."""

    def read(self) -> LiveImage | None:
        """The next image, later than the last one; None where there is none yet.

        Raises:
            EOFError: There will be none any more.
        """

    def close(self) -> None:
        """Let it go; called by the thread that reads."""


class LatestImage:
    """A thread that reads a source and keeps the newest image; a context manager.

    Args:
        source: Read by this thread alone.

    Attributes:
        dropped: How many images nobody has taken, as newer ones had come.
    """

    def __init__(self, source: LiveSource) -> None:
        self._source = source
        self._changed = Condition()
        self._newest: LiveImage | None = None
        self._ended, self._stopped = False, False
        self._error: Exception | None = None
        self._thread = Thread(target=self._read, name="camera", daemon=True)  # a driver may hang for ever
        self.dropped = 0

    def __enter__(self) -> LatestImage:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.stop()

    def take(self, patience: float | None = None) -> LiveImage | None:
        """Wait for an image that nobody has taken.

        Args:
            patience: Seconds to wait at most.

        Returns:
            None where the source has ended, `stop` was called, or there was none in that time.

        Raises:
            FvslamError: The source cannot be read any more.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest or self._ended or self._stopped, patience)
            if self._error is not None:
                raise self._error
            image, self._newest = self._newest, None
            return None if self._stopped else image

    def stop(self) -> None:
        """Take no more images; signal handlers may call it."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _read(self) -> None:
        try:
            while not self._stopped:
                begin = time.monotonic()
                image = self._source.read()
                if image is None:
                    self._pause(max(MIN_PAUSE, PAUSE_PER_LOOK * (time.monotonic() - begin)))
                else:
                    self._keep(image)
        except EOFError:
            pass
        except Exception as error:  # raised again where images are taken
            self._error = error
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()
            self._source.close()

    def _pause(self, seconds: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: self._stopped, seconds)

    def _keep(self, image: LiveImage) -> None:
        with self._changed:
            self.dropped += image.missed + (self._newest is not None)
            self._newest = image
            self._changed.notify_all()
