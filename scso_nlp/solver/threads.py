"""BLAS on one thread: for batches of small matrices its threads cost more than they give on a busy machine.

Measured on two cores under a load of eight, solving, inverting and multiplying 64 matrices at once: with
threads as fast up to a size of 20, 1.3 times slower at 60, and 12 times slower at 127, the size of the Newton
equations of a model of 80 muscles. MUMPS within IPOPT takes twice the processor's time with threads for 114
frames of that model, coupled by rates of activation, under a load of ten.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

import threadpoolctl


class CasadiOpenBLAS(threadpoolctl.OpenBLASController):
    """The library that comes with CasADi, under a name of its own."""

    filename_prefixes = ("libcasadi-tp-openblas",)


threadpoolctl.register(CasadiOpenBLAS)


@cache
def _controller(of_ipopt: bool) -> threadpoolctl.ThreadpoolController:
    return threadpoolctl.ThreadpoolController()


def one_thread(*, of_ipopt: bool = False) -> AbstractContextManager[Any]:
    """Hold BLAS to one thread within a ``with`` block.

    Parameters
    ----------
    of_ipopt : bool
        True for the libraries that are there once a solver has been made, False for those of NumPy.
    """
    limit: AbstractContextManager[Any] = _controller(of_ipopt).limit(limits=1, user_api="blas")
    return limit
