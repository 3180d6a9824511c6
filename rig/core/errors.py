"""Everything that the command line prints as one line instead of a traceback.

A message says what went wrong, with which serial or file, the value, and the next step.
"""

from __future__ import annotations


class RigError(Exception):
    """A problem that a person can act on; the command line exits with 1."""


class UsageError(RigError):
    """A word on the command line that cannot be meant; the command line exits with 2."""


class CameraError(RigError):
    """A camera did not do what it was asked."""


class GrabTimeout(CameraError):
    """No frame came before the deadline.

    `cause` is the same few words for every frame that is lost in the same way, so that losses can
    be counted by it; the message carries the numbers.
    """

    def __init__(self, message: str, cause: str = "no frame in time") -> None:
        super().__init__(message)
        self.cause = cause


class CameraLost(CameraError):
    """The camera stopped answering and must be opened again."""


class RecordingError(RigError):
    """A recording cannot be written or read."""


class DiskFull(RecordingError):
    """The disk filled up: the recording is whole and its losses are counted; exits with 3."""


class RecordingDamaged(RecordingError):
    """A recording is cut short or corrupt; `rig recover` may repair it."""


class ModelError(RigError):
    """A network file cannot be used as a controller."""


class ControllerError(RigError):
    """A controller was built with options that it does not have."""


class ConfigError(RigError):
    """A configuration, calibration or camera-model file does not say what it must."""


class CalibrationError(RigError):
    """A calibration cannot be made from what was seen, or does not belong to these cameras."""
