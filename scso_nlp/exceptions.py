"""Every error this package raises on purpose.

A message says what, where, expected, found and remedy, in one sentence where possible.
The command line turns :class:`ScsoError` into exit code 2 and one line; anything else is a bug.
"""


class ScsoError(Exception):
    """Base class: a failure that the package can explain."""


class DataError(ScsoError):
    """Input data that cannot be used: wrong shape, not finite, out of range, missing."""


class FileFormatError(DataError):
    """A file that cannot be read as what it should be."""


class NameMismatchError(DataError):
    """A muscle, coordinate, joint, axis or column that is not there."""


class EngineError(ScsoError):
    """OpenSim refused the input, or its worker process died."""


class ProblemError(ScsoError):
    """A problem description that contradicts itself."""


class CouplingError(ProblemError):
    """A term that couples frames was given to the frame-wise solver."""
