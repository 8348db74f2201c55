"""Signals during work that must be done are heard when it is done; its processes are deaf to Ctrl-C."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading

import pytest

from scso_nlp.signals import deaf_to_ctrl_c, undisturbed

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


@pytest.fixture(autouse=True)
def as_from_a_terminal():
    previous = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, previous)


@pytest.mark.parametrize("error", [None, ValueError])
def test_an_interrupt_waits_for_the_end_of_the_block(error):
    done = []

    def work():
        with undisturbed():
            os.kill(os.getpid(), signal.SIGINT)
            done.append("work")
            if error:
                raise error

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["work"]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_is_ignored_or_ends_the_process_stays_so():
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    try:
        with undisturbed():
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_in_another_thread_the_block_is_as_good():
    done = []

    def work():
        with undisturbed():
            done.append("work")

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert done == ["work"]


def masked(of_process):
    """Signals that a process keeps waiting, as Linux says of it: a mask, as a hexadecimal number."""
    with open(f"/proc/{of_process}/status") as lines:
        (mask,) = (line.split()[1] for line in lines if line.startswith("SigBlk:"))
    return {number for number in signal.Signals if int(mask, 16) >> (number - 1) & 1}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads masks in /proc")
def test_processes_that_begin_in_the_block_do_not_hear_ctrl_c():
    def start_in_a_thread():
        process = multiprocessing.get_context("spawn").Process(target=signal.pause)
        process.start()
        found.append(masked(process.pid))
        process.kill()
        process.join()

    found = []
    with deaf_to_ctrl_c():
        thread = threading.Thread(target=start_in_a_thread)
        with subprocess.Popen(["sleep", "60"]) as process:
            found.append(masked(process.pid))
            process.terminate()
        thread.start()
    thread.join()
    assert found == [{signal.SIGINT}, {signal.SIGINT}]
    assert signal.SIGINT not in masked("self")
