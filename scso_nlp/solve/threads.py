"""BLAS on one thread: for batches of small matrices its threads cost more than they give on a busy machine.

Measured on two cores under a load of eight, solving, inverting and multiplying 64 matrices at once: with
threads as fast up to a size of 20, 1.3 times slower at 60, and 12 times slower at 127, the size of the Newton
equations of a model of 80 muscles.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any

from threadpoolctl import ThreadpoolController


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


def one_thread() -> AbstractContextManager[Any]:
    """Hold BLAS to one thread within a ``with`` block."""
    limit: AbstractContextManager[Any] = _controller().limit(limits=1, user_api="blas")
    return limit
