"""Recordings that know where each image was taken."""

from splatrl.capture.recordings.reading import is_recording, read_recording

__all__ = ["is_recording", "read_recording"]
