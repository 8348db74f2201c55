"""Muscle forces with mechanically stable joints, from OpenSim models and motions.

Public names stand in ``__init__.pyi`` and are imported when first used, so that ``import scso_nlp`` is fast.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
