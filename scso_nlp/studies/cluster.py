"""Dask: a cluster on this machine, or any that is there already. Nothing of it is home-made.

A worker is one process with one thread that does one trial at a time: BLAS, IPOPT and the OpenSim process
that it starts for an extraction have one thread each.
"""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

from scso_nlp.exceptions import DataError, EngineError
from scso_nlp.opensim.workers import number_of_cores
from scso_nlp.signals import deaf_to_ctrl_c, undisturbed
from scso_nlp.versions import version_of, versions

if TYPE_CHECKING:
    from distributed import Client

#: What a worker and its OpenSim process should have [bytes]; large models with all Hessians take as much.
MEMORY = 2 * 10**9
#: Libraries read their number of threads from these before they start.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
#: What workers of a cluster made here leave out: what they would do before their memory is full, which is for
#: those who keep results in it; and samples of themselves, kept for 1,000 s: 22 MiB over 300 tiny trials.
LEFT_OUT = ("memory.target", "memory.spill", "memory.pause", "profile.enabled")
#: What workers of a cluster made here run first, for systems where they cannot be made deaf to it before.
CTRL_C_IS_NOT_FOR_WORKERS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
#: How long a scheduler may take to answer [s].
PATIENCE = 20.0


@contextlib.contextmanager
def client_of(scheduler: str | None, workers: int | None) -> Iterator[Client]:
    """Give a client of a cluster; one that is made here ends with the block.

    Parameters
    ----------
    scheduler : str or None
        Address of a scheduler that runs, e.g. ``"tcp://host:8786"``; None is a cluster on this machine.
    workers : int or None
        Of the cluster on this machine; by default one per core, fewer where memory is short.

    Yields
    ------
    distributed.Client

    Raises
    ------
    DataError
        `workers` for a cluster that has its own, or fewer than one.
    EngineError
        Dask is not installed, or no scheduler answers.
    """
    if workers is not None and scheduler is not None:
        raise DataError(f"workers is {workers}, but the cluster at {scheduler} has its own: leave it out")
    if workers is not None and workers < 1:
        raise DataError(f"workers is {workers}, expected 1 or more")
    with contextlib.ExitStack() as made:
        client = _started(made, scheduler, workers)
        try:
            yield client
        finally:
            # what has begun to end is not cut short
            with undisturbed():
                made.close()


def _started(made: contextlib.ExitStack, scheduler: str | None, workers: int | None) -> Client:
    """Start a cluster where there is none, and a client; what is made ends with the stack."""
    try:
        with undisturbed():
            from distributed import Client, LocalCluster
    except ImportError:
        raise EngineError("Dask is not installed: pip install 'scso_nlp[studies]'") from None
    # what is lost is told of by the trials
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)
    if scheduler is not None:
        try:
            client = made.enter_context(Client(scheduler, timeout=PATIENCE, set_as_default=False))
        except (OSError, ValueError) as error:
            raise EngineError(f"no Dask scheduler answers at {scheduler}: {error}") from None
        _refuse_other_versions(client, scheduler)
        return client
    # one that is left half made cannot be closed
    with undisturbed(), deaf_to_ctrl_c():
        try:
            cluster = LocalCluster(
                n_workers=workers or default_workers(),
                threads_per_worker=1,
                processes=True,
                memory_limit="auto",  # an equal share; a worker that takes nearly all of it is started anew
                host="127.0.0.1",
                dashboard_address="127.0.0.1:0",  # any that is free: several studies may run
                env={**dict.fromkeys(THREADS, "1"), "MPLBACKEND": "agg"},
                # not by their environment, over which the configuration of this process is laid
                config={f"distributed.worker.{name}": False for name in LEFT_OUT},
                silence_logs=logging.CRITICAL,
                preload=[CTRL_C_IS_NOT_FOR_WORKERS],
            )
        except (RuntimeError, OSError, ValueError) as error:
            raise EngineError(f"Dask cannot start workers on this machine: {error}") from None
        made.enter_context(cluster)
        return made.enter_context(Client(cluster, set_as_default=False))


def _refuse_other_versions(client: Client, scheduler: str) -> None:
    """Raise if workers that are there have another version of this package, or none."""
    own = versions()["scso_nlp"]
    try:
        found = set(client.run(version_of, "scso_nlp").values())
    except Exception as error:
        raise EngineError(f"the workers of {scheduler} cannot run scso_nlp: {error}") from None
    if others := sorted(str(version) for version in found - {own}):
        raise EngineError(
            f"workers of {scheduler} have scso_nlp {', '.join(others)}, expected {own} as here: give them "
            "the same environment"
        )


def default_workers() -> int:
    """Return how many workers this machine has cores and memory for."""
    import psutil  # comes with Dask

    memory = int(psutil.virtual_memory().total)
    return max(min(number_of_cores(), memory // MEMORY), 1)
