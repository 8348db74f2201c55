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
