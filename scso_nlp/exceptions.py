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
    """OpenSim refused the input, its worker process died, or the solver cannot work on this machine."""


class ProblemError(ScsoError):
    """A problem description that contradicts itself."""


class ArgumentError(DataError, ProblemError):
    """A value of the wrong type was given to a function or a data class."""


class CouplingError(ProblemError):
    """A term that couples frames was given to the frame-wise solver."""


def loading_fault(error: ImportError) -> str:
    """Say why CasADi cannot be loaded where OpenSim's copy of its library came first; else empty.

    Parameters
    ----------
    error : ImportError

    Returns
    -------
    str
    """
    if "casadi" not in str(error):
        return ""
    return (
        "CasADi cannot be loaded, because OpenSim has a library of the same name: import scso_nlp in a "
        "process that does not import opensim (load_motion starts its own), and take OpenSim's folder out of "
        f"LD_LIBRARY_PATH (what the system says: {error})"
    )
