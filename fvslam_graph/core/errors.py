"""Errors that a user is told when a file, a setting or a run is not usable: one sentence, no traceback."""


class FvslamError(Exception):
    """Base of all errors of this package; the message says what, where and what to do."""


class CameraError(FvslamError):
    """A calibration that cannot be read or does not fit the images."""


class SequenceError(FvslamError):
    """A recording that cannot be recognised or read."""


class TrajectoryError(FvslamError):
    """A trajectory that cannot be read, written or associated."""


class ConfigError(FvslamError):
    """Settings that are unknown or outside their range."""


class ResultsError(FvslamError):
    """A run folder that cannot be read or written."""


class EstimationError(FvslamError):
    """An estimate that cannot be made from what was measured."""


class DatasetError(FvslamError):
    """A published recording that is unknown, or does not come as it should."""


class StudyError(FvslamError):
    """A study that is not well declared, or cannot be carried out."""
