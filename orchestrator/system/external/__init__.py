"""What is no FMU and runs as one: programs and rigs that are reached over UDP, and files of signals."""

from .component import ExternalFmu
from .playback import SUFFIX, SignalFmu, read_header, targets_of

__all__ = ["SUFFIX", "ExternalFmu", "SignalFmu", "read_header", "targets_of"]
