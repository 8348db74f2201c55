"""A cluster on this machine is started whole, and ended whole, also where it is stopped on its way."""

import os
import signal

import pytest

from scso_nlp.studies.cluster import client_of

distributed = pytest.importorskip("distributed", reason="needs Dask; pip install '.[studies]' brings it")


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_while_a_cluster_starts_is_heard_when_it_can_be_closed(monkeypatch, capfd):
    start, clusters = distributed.Nanny.start_unsafe, []

    async def interrupted(nanny):
        clusters.extend(distributed.SpecCluster._instances)
        os.kill(os.getpid(), signal.SIGINT)
        return await start(nanny)

    monkeypatch.setattr(distributed.Nanny, "start_unsafe", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt), client_of(None, 1):
            pytest.fail("not heard")
    finally:
        signal.signal(signal.SIGINT, before)
    (cluster,) = clusters
    assert cluster.status is distributed.Status.closed
    assert "Traceback" not in capfd.readouterr().err


def test_workers_have_one_thread_and_leave_out_what_takes_memory_or_waits_for_it():
    with client_of(None, 1) as client:
        (found,) = client.run(
            lambda dask_worker: {
                "threads": os.environ["OMP_NUM_THREADS"],
                "repeated": set(dask_worker.periodic_callbacks),
                "memory": [
                    getattr(dask_worker.memory_manager, f"memory_{what}_fraction")
                    for what in ("target", "spill", "pause")
                ],
            }
        ).values()
    assert found["threads"] == "1"
    assert "heartbeat" in found["repeated"]
    assert not {"profile", "profile-cycle"} & found["repeated"]
    assert found["memory"] == [False, False, False]
