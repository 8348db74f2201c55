"""Muscle forces with mechanically stable joints, from OpenSim models and motions.

Public names stand in ``__init__.pyi`` and are imported when first used, so that ``import scso_nlp`` is fast.
"""

import lazy_loader

from scso_nlp.accessors import offer
from scso_nlp.exceptions import EngineError, loading_fault

offer("plot", "scso_nlp.figures.plots:SolutionPlots")

_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name; a CasADi that OpenSim is in the way of is said in a sentence."""
    try:
        return _find(name)
    except ImportError as error:
        if fault := loading_fault(error):
            raise EngineError(fault) from None
        raise
